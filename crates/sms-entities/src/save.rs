//! Entities on disk: `<name>/{cloud.ply, mesh.obj, textured.{obj,mtl,png}, parts/*.obj, entity.json}`, and a list of
//! them in `entities.json`.

use crate::{EntitiesError, EntitySet};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{
    Entity, EntityKind, EntityShape, InputError, Mesh, PointCloud, atomic, read_mesh_texture,
    write_textured_obj,
};
use std::path::Path;

/// File stem of the textured mesh.
const TEXTURED: &str = "textured";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct IndexFile {
    support_height_m: Option<f64>,
    #[serde(default)]
    joined: Vec<(u16, u16)>,
    entities: Vec<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EntityFile {
    label: u16,
    name: String,
    description: String,
    kind: EntityKind,
    shape: EntityShape,
    parts: usize,
    observed_share: f64,
    residual_m: f64,
    mean_color: [u8; 3],
}

/// Writes every entity into a folder with its name in `dir`.
///
/// # Errors
/// [`EntitiesError::Core`] when a file cannot be written.
pub fn save_entities(dir: &Path, set: &EntitySet) -> Result<(), EntitiesError> {
    set.entities.par_iter().try_for_each(|entity| save_entity(&dir.join(&entity.name), entity))?;
    let index = IndexFile {
        support_height_m: set.support_height,
        joined: set.joined.clone(),
        entities: set.entities.iter().map(|e| e.name.clone()).collect(),
    };
    atomic::write_json(&dir.join("entities.json"), &index)?;
    Ok(())
}

fn save_entity(folder: &Path, entity: &Entity) -> Result<(), EntitiesError> {
    entity.cloud.write_ply(&folder.join("cloud.ply"))?;
    entity.mesh.write_obj(&folder.join("mesh.obj"))?;
    if let Some(texture) = &entity.texture {
        write_textured_obj(&entity.mesh, texture, folder, TEXTURED)?;
    }
    for (i, part) in entity.parts.iter().enumerate() {
        part.write_obj(&folder.join("parts").join(format!("{i:03}.obj")))?;
    }
    let file = EntityFile {
        label: entity.label,
        name: entity.name.clone(),
        description: entity.description.clone(),
        kind: entity.kind,
        shape: entity.shape.clone(),
        parts: entity.parts.len(),
        observed_share: entity.observed_share,
        residual_m: entity.residual_m,
        mean_color: entity.mean_color,
    };
    atomic::write_json(&folder.join("entity.json"), &file)?;
    Ok(())
}

/// Reads the files of [`save_entities`]. Coordinates come back rounded to the nanometre (meshes) and to `f32` (clouds).
///
/// # Errors
/// [`EntitiesError::Core`] naming the file that is missing or wrong.
pub fn load_entities(dir: &Path) -> Result<EntitySet, EntitiesError> {
    let index_path = dir.join("entities.json");
    let index: IndexFile = atomic::read_json(&index_path)?;
    let load = |name: &String| {
        let plain = std::path::Path::new(name).file_name().is_some_and(|n| n == name.as_str());
        if !plain {
            let what = format!("the entity name `{name}` is not a folder name");
            return Err(InputError::new(what, &index_path, "run `sms materialize` again").into());
        }
        let folder = dir.join(name);
        let file: EntityFile = atomic::read_json(&folder.join("entity.json"))?;
        let parts: Vec<Mesh> = (0..file.parts)
            .map(|i| Mesh::read_obj(&folder.join("parts").join(format!("{i:03}.obj"))))
            .collect::<Result<_, _>>()?;
        Ok::<Entity, EntitiesError>(Entity {
            label: file.label,
            name: file.name,
            description: file.description,
            kind: file.kind,
            shape: file.shape,
            cloud: PointCloud::read_ply(&folder.join("cloud.ply"))?,
            mesh: Mesh::read_obj(&folder.join("mesh.obj"))?,
            texture: read_mesh_texture(&folder, TEXTURED)?,
            parts,
            observed_share: file.observed_share,
            residual_m: file.residual_m,
            mean_color: file.mean_color,
        })
    };
    // The first error of the list, whichever comes first in time.
    let entities: Vec<_> = index.entities.par_iter().map(load).collect();
    let entities = entities.into_iter().collect::<Result<_, _>>()?;
    Ok(EntitySet { entities, support_height: index.support_height_m, joined: index.joined })
}
