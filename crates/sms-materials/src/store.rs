//! `materials.json`: what each object was taken to be made of.

use crate::ObjectQuery;
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, Material, atomic};
use std::path::Path;

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    name: String,
    material: Material,
}

/// Writes objects' names with their materials, in order.
///
/// # Errors
/// [`CoreError::Write`].
pub fn save_materials(path: &Path, materials: &[(String, Material)]) -> Result<(), CoreError> {
    let row = |(name, material): &(String, Material)| Row { name: name.clone(), material: material.clone() };
    atomic::write_json(path, &materials.iter().map(row).collect::<Vec<_>>())
}

/// Reads what [`save_materials`] wrote.
///
/// # Errors
/// [`CoreError::Read`] when there is no such file; [`CoreError::Input`] naming the file when it is damaged, names an
/// object twice or holds an interval out of order.
pub fn load_materials(path: &Path) -> Result<Vec<(String, Material)>, CoreError> {
    let rows: Vec<Row> = atomic::read_json(path)?;
    let fault =
        |what: String| InputError::new(what, path, "restore the file, or run `sms materialize` again");
    for (index, row) in rows.iter().enumerate() {
        if rows[..index].iter().any(|other| other.name == row.name) {
            return Err(fault(format!("the object `{}` is there twice", row.name)).into());
        }
        let m = &row.material;
        for (key, property) in [
            ("density", m.density),
            ("fill_factor", m.fill_factor),
            ("friction", m.friction),
            ("restitution", m.restitution),
            ("rolling_m", m.rolling_m),
            ("youngs_modulus_pa", m.youngs_modulus_pa),
            ("poissons_ratio", m.poissons_ratio),
        ] {
            let v = property.value;
            if !(0.0 <= v.low && v.low <= v.best && v.best <= v.high && v.high.is_finite()) {
                return Err(fault(format!("{key} of `{}` has an interval out of order", row.name)).into());
            }
        }
    }
    Ok(rows.into_iter().map(|row| (row.name, row.material)).collect())
}

/// Writes what was known of every object, from which its material followed: so that the effect of an edit can be shown
/// without materializing again.
///
/// # Errors
/// [`CoreError::Write`].
pub fn save_queries(path: &Path, objects: &[ObjectQuery]) -> Result<(), CoreError> {
    atomic::write_json(path, &objects)
}

/// Reads what [`save_queries`] wrote.
///
/// # Errors
/// [`CoreError::Read`] when there is no such file; [`CoreError::Input`] when it is damaged.
pub fn load_queries(path: &Path) -> Result<Vec<ObjectQuery>, CoreError> {
    atomic::read_json(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MaterialTable;

    #[test]
    fn queries_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("objects.json");
        let estimate = crate::Estimate {
            material: "glass".into(),
            density: Some(sms_core::Interval::new(2500.0, 2300.0, 2700.0)),
            ..Default::default()
        };
        let objects = vec![
            ObjectQuery { name: "a".into(), hull_fill: 0.3, volume_m3: 1e-3, ..Default::default() },
            ObjectQuery { name: "b".into(), estimate: Some(estimate), ..Default::default() },
        ];
        save_queries(&path, &objects).unwrap();
        assert_eq!(load_queries(&path).unwrap(), objects);
    }

    #[test]
    fn materials_round_trip_and_damage_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("materials.json");
        let table = MaterialTable::builtin();
        let materials = vec![
            ("mug".to_owned(), table.class("ceramic").unwrap()),
            ("what".to_owned(), table.prior(false)),
        ];
        save_materials(&path, &materials).unwrap();
        assert_eq!(load_materials(&path).unwrap(), materials);
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to, word) in [
            ("\"what\"", "\"mug\"", "twice"),
            ("\"low\": 0.25", "\"low\": 0.75", "friction of `mug`"),
            ("\"class\"", "\"clas\"", "materials.json"),
        ] {
            assert!(text.contains(from));
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            let message = load_materials(&path).unwrap_err().to_string();
            assert!(message.contains(word) && message.contains("cure"), "{message}");
        }
    }
}
