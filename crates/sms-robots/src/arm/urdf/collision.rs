//! Collision shapes of a link.

use super::UrdfOptions;
use super::stl::read_points;
use super::xml::{UrdfSource, place};
use crate::LinkShape;
use glamx::{DPose3, DVec3};
use roxmltree::Node;
use sms_core::InputError;
use std::path::PathBuf;

/// Shapes of a link with their poses in the link's frame.
pub(super) fn shapes(
    source: &UrdfSource,
    link: Node,
    options: &UrdfOptions,
) -> Result<Vec<(DPose3, LinkShape)>, InputError> {
    let mut all = Vec::new();
    for node in link.children().filter(|c| c.has_tag_name("collision")) {
        let geometry = source.child(node, "geometry").and_then(|g| g.children().find(Node::is_element));
        let Some(geometry) = geometry else {
            return Err(source.error(
                format!("<collision> at {} has no geometry", place(node)),
                "state a sphere, cylinder, box or mesh there, or remove the element",
            ));
        };
        all.push((source.origin(node)?, shape(source, geometry, options)?));
    }
    merge_capsules(&mut all);
    Ok(all)
}

fn shape(source: &UrdfSource, node: Node, options: &UrdfOptions) -> Result<LinkShape, InputError> {
    let length = |key: &str| {
        let value = source.required(node, key)?;
        if value > 0.0 {
            return Ok(value);
        }
        Err(source.error(
            format!("{key} of <{}> at {} is {value}", node.tag_name().name(), place(node)),
            "lengths of shapes are positive, in metres",
        ))
    };
    Ok(match node.tag_name().name() {
        "sphere" => LinkShape::Sphere { radius: length("radius")? },
        "cylinder" => LinkShape::Cylinder { half_length: 0.5 * length("length")?, radius: length("radius")? },
        "capsule" => LinkShape::Capsule { half_length: 0.5 * length("length")?, radius: length("radius")? },
        "box" => {
            source.attribute(node, "size")?;
            let size = source.vector(node, "size")?.unwrap_or(DVec3::ZERO);
            if size.min_element() <= 0.0 {
                return Err(source.error(
                    format!("the box at {} has the size {size}", place(node)),
                    "edges are positive, in metres",
                ));
            }
            LinkShape::Box { half: 0.5 * size }
        }
        "mesh" => {
            let scale = source.vector(node, "scale")?.unwrap_or(DVec3::ONE);
            if scale.to_array().contains(&0.0) {
                return Err(source.error(
                    format!("the mesh at {} has a zero scale ({scale})", place(node)),
                    "state factors other than zero",
                ));
            }
            let path = find_mesh(source, source.attribute(node, "filename")?, options)?;
            // Only the hull is used, so that non-uniform or mirroring factors do no harm.
            let points: Vec<DVec3> = read_points(&path)?.into_iter().map(|p| scale * p).collect();
            LinkShape::convex(&points).ok_or_else(|| {
                InputError::new(
                    "this collision mesh encloses no volume",
                    &path,
                    "use a solid mesh, or a box, cylinder or sphere in the URDF",
                )
            })?
        }
        other => {
            return Err(source.error(
                format!("<{other}> at {} is not a supported collision shape", place(node)),
                "use sphere, cylinder, capsule, box or mesh",
            ));
        }
    })
}

fn find_mesh(source: &UrdfSource, name: &str, options: &UrdfOptions) -> Result<PathBuf, InputError> {
    let here = source.path.parent().map_or_else(PathBuf::new, PathBuf::from);
    let mut candidates = Vec::new();
    if let Some(rest) = name.strip_prefix("package://").or_else(|| name.strip_prefix("model://")) {
        let (package, inside) = rest.split_once('/').unwrap_or((rest, ""));
        for folder in std::path::absolute(&here).unwrap_or(here).ancestors() {
            candidates.push(folder.join(package).join(inside));
            candidates.push(folder.join(inside));
        }
        for folder in &options.package_folders {
            candidates.push(folder.join(package).join(inside));
            if folder.file_name().is_some_and(|f| f == package) {
                candidates.push(folder.join(inside));
            }
        }
    } else {
        candidates.push(here.join(name.strip_prefix("file://").unwrap_or(name)));
    }
    candidates.into_iter().find(|p| p.is_file()).ok_or_else(|| {
        let cure = if name.contains("://") && !name.starts_with("file://") {
            "put the package's folder beside the URDF, or name the folder that holds it in `package_folders`"
        } else {
            "put the mesh where the URDF says, relative to the URDF's folder, or correct the file name"
        };
        source.error(format!("the collision mesh {name} does not exist"), cure)
    })
}

/// Merges a cylinder with spheres of its radius at both ends, a common notation, into a capsule.
fn merge_capsules(all: &mut Vec<(DPose3, LinkShape)>) {
    let mut i = 0;
    while i < all.len() {
        if let LinkShape::Cylinder { half_length, radius } = all[i].1 {
            let ball_at = |all: &[(DPose3, LinkShape)], z: f64| {
                let end = all[i].0.transform_point(DVec3::new(0.0, 0.0, z));
                all.iter().position(|(x, s)| {
                    matches!(s, LinkShape::Sphere { radius: r } if (r - radius).abs() < 1e-6)
                        && x.translation.distance(end) < 1e-5
                })
            };
            if let (Some(a), Some(b)) = (ball_at(all, half_length), ball_at(all, -half_length))
                && a != b
            {
                all[i].1 = LinkShape::Capsule { half_length, radius };
                all.remove(a.max(b));
                all.remove(a.min(b));
                i -= usize::from(a < i) + usize::from(b < i);
            }
        }
        i += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cylinder_with_round_ends_becomes_one_capsule() {
        let at = |x: f64, z: f64| DPose3::from_translation(DVec3::new(x, 0.0, z));
        let mut all = vec![
            (at(0.0, 0.2), LinkShape::Sphere { radius: 0.05 }),
            (at(0.0, 0.0), LinkShape::Cylinder { half_length: 0.2, radius: 0.05 }),
            (at(0.0, -0.2), LinkShape::Sphere { radius: 0.05 }),
            (at(1.0, 0.0), LinkShape::Cylinder { half_length: 0.2, radius: 0.05 }),
            (at(1.0, 0.2), LinkShape::Sphere { radius: 0.05 }),
        ];
        merge_capsules(&mut all);
        assert_eq!(all.len(), 3);
        assert!(matches!(all[0].1, LinkShape::Capsule { .. }));
        assert!(matches!(all[1].1, LinkShape::Cylinder { .. }), "one end is missing");
    }
}
