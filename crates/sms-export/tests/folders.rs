//! Exports as folders: the same bytes each time, only relative paths, movable, with their Gaussians.

use sms_core::Seed;
use sms_export::{Format, Sources, export};
use sms_synth::{BilliardsSettings, generate_billiards};
use sms_target::scene_from_truth;
use std::collections::BTreeMap;
use std::path::Path;

fn tree(dir: &Path, root: &Path, files: &mut BTreeMap<String, Vec<u8>>) {
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            tree(&path, root, files);
        } else {
            let name = path.strip_prefix(root).unwrap().to_string_lossy().into_owned();
            files.insert(name, std::fs::read(&path).unwrap());
        }
    }
}

fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    tree(dir, dir, &mut files);
    files
}

#[test]
fn every_format_gives_the_same_bytes_wherever_it_lies() {
    let truth = generate_billiards(Seed(3), &BilliardsSettings::default());
    let scene = scene_from_truth(&truth).unwrap();
    let root = tempfile::tempdir().unwrap();
    let gaussians = root.path().join("gaussians");
    std::fs::create_dir(&gaussians).unwrap();
    let moving = scene.bodies.last().unwrap().name.clone();
    std::fs::write(gaussians.join(format!("{moving}.ply")), b"ply of a body").unwrap();
    std::fs::write(gaussians.join("stranger.ply"), b"of no body").unwrap();
    let sources = Sources { gaussians: Some(gaussians) };
    let here = root.path().to_string_lossy().into_owned();
    for format in Format::ALL {
        let (a, b) = (root.path().join("a").join(format.name()), root.path().join("b").join("deeper"));
        let main = export(&scene, format, &sources, &a).unwrap();
        export(&scene, format, &sources, &b).unwrap();
        assert!(main.is_file(), "{main:?}");
        let (first, second) = (files(&a), files(&b));
        assert!(first == second, "{} differs", format.name());
        assert_eq!(first[&format!("gaussians/{moving}.ply")], b"ply of a body");
        assert!(!first.contains_key("gaussians/stranger.ply"));
        for (name, bytes) in &first {
            let text = String::from_utf8_lossy(bytes);
            assert!(!text.contains(&here), "{}/{name} names its own place", format.name());
        }
        let readme = String::from_utf8_lossy(&first["README.md"]);
        for body in &scene.bodies {
            assert!(readme.contains(&format!("`{}`", body.name)), "{}: {readme}", format.name());
        }
        // Every mesh that bodies.json names is there.
        let list: serde_json::Value = serde_json::from_slice(&first["bodies.json"]).unwrap();
        for body in list["bodies"].as_array().unwrap() {
            let hulls = body["shape"]["files"].as_array().into_iter().flatten();
            for file in hulls.chain(body.get("visual")).chain(body["shape"].get("file")) {
                let file = file.as_str().unwrap();
                assert!(first.contains_key(file), "{}: {file}", format.name());
            }
        }
    }
}
