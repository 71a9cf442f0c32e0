//! Recordings that are followed while their folder grows.

use crate::common::{Written, save, write};
use serde_json::Value;
use sms_core::{Cancel, NoProgress, StageContext, Warnings};
use sms_frames::{Align, FollowedFrames, FramesError, LoadSettings, ReadOptions, Recording, load};
use std::path::{Path, PathBuf};
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(2);

/// Copies a complete recording file by file, as a recorder writes it: the last depth image is incomplete at first.
fn record_slowly(complete: &Path, json: &Value, to: &Path) {
    let frames = json["frames"].as_array().unwrap();
    for count in 1..=frames.len() {
        for key in ["file_path", "depth_file_path"] {
            let name = frames[count - 1][key].as_str().unwrap();
            std::fs::create_dir_all(to.join(name).parent().unwrap()).unwrap();
            let bytes = std::fs::read(complete.join(name)).unwrap();
            if key == "depth_file_path" && count == frames.len() {
                std::fs::write(to.join(name), &bytes[..bytes.len() / 2]).unwrap();
                let mut so_far = json.clone();
                so_far["frames"].as_array_mut().unwrap().truncate(count);
                save(to, &so_far);
                std::thread::sleep(Duration::from_millis(500));
            }
            std::fs::write(to.join(name), bytes).unwrap();
        }
        // A listing that is being written.
        std::fs::write(to.join("transforms.json"), "{\"frames\": [").unwrap();
        std::thread::sleep(Duration::from_millis(50));
        let mut so_far = json.clone();
        so_far["frames"].as_array_mut().unwrap().truncate(count);
        save(to, &so_far);
        std::thread::sleep(Duration::from_millis(250));
    }
}

#[test]
fn frames_come_as_they_are_written_and_are_those_of_the_complete_recording() {
    let (from, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let json = write(from.path(), &Written { frames: 5, ..Written::default() });
    let (read, settings) =
        (ReadOptions::default(), LoadSettings { align: Align::None, ..LoadSettings::default() });
    let cancel = Cancel::new();
    // The folder does not exist yet.
    let grows = to.path().join("recording");
    let followed = std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_millis(300));
            record_slowly(from.path(), &json, &grows);
        });
        let frames = FollowedFrames::new(&grows, &read, &settings, PATIENCE, &cancel).unwrap();
        let mut frames = frames.collect::<Result<Vec<_>, _>>().unwrap();
        assert!(frames.iter().enumerate().all(|(i, frame)| frame.index == i));
        // Two that arrive at once come in another order.
        frames.sort_by(|a, b| a.color_path.file_name().cmp(&b.color_path.file_name()));
        frames
    });
    let warnings = Warnings::new();
    let recording = Recording::open(from.path(), &read).unwrap();
    let at_once = load(&recording, &settings, StageContext::new(&NoProgress, &cancel, &warnings)).unwrap();
    assert_eq!(followed.len(), 5);
    for (a, b) in followed.iter().zip(&at_once.frames) {
        assert_eq!(a.camera.x_wc, b.camera.x_wc);
        assert!(a.color.data == b.color.data && a.depth.data == b.depth.data);
    }
}

#[test]
fn whoever_waits_in_vain_is_told_that_nothing_came_or_can_cancel() {
    let (read, settings, cancel) = (ReadOptions::default(), LoadSettings::default(), Cancel::new());
    let nowhere = PathBuf::from("no such recording");
    let follow = |dir: &Path, seconds: u64| {
        let frames = FollowedFrames::new(dir, &read, &settings, Duration::from_secs(seconds), &cancel);
        frames.unwrap().collect::<Result<Vec<_>, _>>()
    };
    assert!(follow(&nowhere, 0).unwrap().is_empty());
    cancel.cancel();
    assert!(matches!(follow(&nowhere, 3600), Err(FramesError::Interrupted)));
}

#[test]
fn frames_without_poses_are_waited_for_but_not_returned() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &Written { frames: 3, ..Written::default() });
    let read = ReadOptions { ignore_poses: true, ..ReadOptions::default() };
    let (settings, cancel) = (LoadSettings::default(), Cancel::new());
    let patience = Duration::from_millis(300);
    let mut frames = FollowedFrames::new(dir.path(), &read, &settings, patience, &cancel).unwrap();
    assert!(frames.next().is_none());
}
