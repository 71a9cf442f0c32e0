//! The JSON Schema of `scene.json`.

/// JSON Schema (draft 2020-12) of `scene.json`.
pub const SCENE_SCHEMA: &str = include_str!("scene.schema.json");

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, example_material, floor_body, save_scene};
    use glamx::{DPose3, DVec3};
    use serde_json::Value;
    use sms_core::Mesh;

    /// Returns the places where a value differs from a schema. It knows the keywords that the schema of scenes uses, and
    /// refuses keys that the schema does not list.
    fn differences(value: &Value, schema: &Value, root: &Value, at: &str) -> Vec<String> {
        let mut found = Vec::new();
        for (keyword, rule) in schema.as_object().unwrap() {
            let items = value.as_array().map_or(0, Vec::len) as u64;
            let holds = match keyword.as_str() {
                "$schema" | "$defs" | "title" | "description" => true,
                "$ref" => {
                    let target = root.pointer(rule.as_str().unwrap().trim_start_matches('#')).unwrap();
                    found.extend(differences(value, target, root, at));
                    true
                }
                "type" => {
                    let is = |name: &Value| match name.as_str().unwrap() {
                        "object" => value.is_object(),
                        "array" => value.is_array(),
                        "string" => value.is_string(),
                        "number" => value.is_number(),
                        "integer" => value.is_u64(),
                        "null" => value.is_null(),
                        other => panic!("unknown type {other}"),
                    };
                    rule.as_array().map_or_else(|| is(rule), |names| names.iter().any(is))
                }
                "const" => value == rule,
                "enum" => rule.as_array().unwrap().contains(value),
                "minimum" => value.as_f64().is_none_or(|v| v >= rule.as_f64().unwrap()),
                "maximum" => value.as_f64().is_none_or(|v| v <= rule.as_f64().unwrap()),
                "minItems" => items >= rule.as_u64().unwrap(),
                "maxItems" => items <= rule.as_u64().unwrap(),
                "required" => {
                    let keys = rule.as_array().unwrap().iter().map(|k| k.as_str().unwrap());
                    keys.into_iter().all(|key| value.get(key).is_some())
                }
                "properties" => {
                    for (key, part) in value.as_object().into_iter().flatten() {
                        match rule.get(key) {
                            Some(schema) => {
                                found.extend(differences(part, schema, root, &format!("{at}/{key}")));
                            }
                            None => found.push(format!("{at}/{key}: not listed")),
                        }
                    }
                    true
                }
                "items" => {
                    for (i, item) in value.as_array().into_iter().flatten().enumerate() {
                        found.extend(differences(item, rule, root, &format!("{at}/{i}")));
                    }
                    true
                }
                "anyOf" => {
                    rule.as_array().unwrap().iter().any(|one| differences(value, one, root, at).is_empty())
                }
                other => panic!("unknown keyword {other}"),
            };
            if !holds {
                found.push(format!("{at}: {keyword}"));
            }
        }
        found
    }

    #[test]
    fn scenes_with_every_shape_follow_the_schema() {
        let mesh = Mesh::cuboid(DVec3::splat(0.03));
        let mass = sms_core::polyhedron_mass_properties(&mesh, 900.0).unwrap();
        let shapes = [
            BodyShape::Sphere { radius: 0.03 },
            BodyShape::Box { half_extents: DVec3::splat(0.03) },
            BodyShape::Cylinder { radius: 0.03, half_length: 0.03 },
            BodyShape::Hulls { hulls: vec![mesh.clone()] },
            BodyShape::TriMesh { mesh: mesh.clone() },
        ];
        let body = |(k, shape): (usize, BodyShape)| {
            let is_static = matches!(shape, BodyShape::TriMesh { .. });
            Body {
                name: format!("body_{k}"),
                label: k as u16 + 1,
                kind: if is_static { BodyKind::Static } else { BodyKind::Dynamic },
                mass: (!is_static).then_some(mass),
                visual: mesh.clone(),
                shape,
                ..floor_body(0.0, example_material())
            }
        };
        let mut bodies = vec![floor_body(0.0, example_material())];
        bodies.extend(shapes.into_iter().enumerate().map(body));
        let scene = Scene {
            version: SCENE_VERSION,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z * 9.81,
            size_sigma: 0.002,
            x_world_recording: DPose3::identity(),
            bodies,
        };
        let dir = tempfile::tempdir().unwrap();
        save_scene(dir.path(), &scene).unwrap();
        let text = std::fs::read_to_string(dir.path().join("scene.json")).unwrap();
        let mut value: Value = serde_json::from_str(&text).unwrap();
        let schema: Value = serde_json::from_str(SCENE_SCHEMA).unwrap();
        assert_eq!(differences(&value, &schema, &schema, ""), [""; 0]);

        // A schema that accepts everything would pass, too.
        value["bodies"][1]["shape"]["radius"] = "wide".into();
        value["bodies"][2]["mass"]["mass_g"] = 3.0.into();
        value["bodies"][0].as_object_mut().unwrap().remove("x_wb");
        let expected = ["/bodies/0: required", "/bodies/1/shape: anyOf", "/bodies/2/mass: anyOf"];
        assert_eq!(differences(&value, &schema, &schema, ""), expected);
    }
}
