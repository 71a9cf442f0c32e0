//! Bad input gives one clear message that names the file and the cure, and exit code 2.

use crate::common::{CopiedRun, copy, recording, sms};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

struct Broken {
    dir: tempfile::TempDir,
}

impl Broken {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        copy(recording(), &dir.path().join("recording"));
        Self { dir }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join("recording").join(name)
    }

    fn edit(&self, change: impl FnOnce(&mut Value)) -> &Self {
        let path = self.path("transforms.json");
        let mut value: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        change(&mut value);
        fs::write(&path, value.to_string()).unwrap();
        self
    }

    /// Scans; the message must be one of bad input and hold every word.
    fn refused(&self, words: &[&str], more: &[&str]) {
        let recording = self.dir.path().join("recording");
        let run = self.dir.path().join("run");
        let mut arguments = vec!["scan", recording.to_str().unwrap(), "--out", run.to_str().unwrap()];
        arguments.extend(["--preset", "draft"]);
        arguments.extend(more);
        expect_refusal(&sms(&arguments), words);
        assert!(!run.join("gaussians").exists());
    }
}

fn expect_refusal(output: &Output, words: &[&str]) {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("cure:"), "{message}");
    assert_eq!(message.matches("error:").count(), 1, "one message: {message}");
    for word in words {
        assert!(message.contains(word), "`{word}` is missing in: {message}");
    }
}

#[cfg(unix)]
#[test]
fn a_reader_that_closes_its_end_does_not_end_the_program_early() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let mut command = Command::new(env!("CARGO_BIN_EXE_sms"));
    command.args(["status", "/no/such/run"]).stderr(writer);
    assert_eq!(command.status().unwrap().code(), Some(2));
}

fn blank_png(path: &Path, width: u32, height: u32) {
    let pixels = vec![0u8; (width * height * 2) as usize];
    let image = sms_core::Image::from_vec(
        width as usize,
        height as usize,
        pixels.chunks_exact(2).map(|p| u16::from_be_bytes([p[0], p[1]])).collect(),
    );
    sms_core::write_png_gray16(path, &image).unwrap();
}

#[test]
fn a_missing_recording() {
    let dir = tempfile::tempdir().unwrap();
    let nowhere = dir.path().join("nowhere");
    let run = dir.path().join("run");
    expect_refusal(&sms(&["scan", nowhere.to_str().unwrap(), "--out", run.to_str().unwrap()]), &["nowhere"]);
    expect_refusal(&sms(&["check", nowhere.to_str().unwrap()]), &["nowhere"]);
    expect_refusal(&sms(&["materialize", nowhere.to_str().unwrap()]), &["nowhere", "sms scan"]);
}

#[test]
fn images_that_are_missing_cut_short_or_of_another_size() {
    let b = Broken::new();
    fs::remove_file(b.path("depth/000003.png")).unwrap();
    b.refused(&["000003.png"], &[]);
    let b = Broken::new();
    let victim = b.path("color/000002.png");
    let bytes = fs::read(&victim).unwrap();
    fs::write(&victim, &bytes[..bytes.len() - 300]).unwrap();
    b.refused(&["000002.png"], &[]);
    let b = Broken::new();
    for entry in fs::read_dir(b.path("depth")).unwrap() {
        blank_png(&entry.unwrap().path(), 100, 77);
    }
    b.refused(&["depth", "100"], &[]);
}

#[test]
fn poses_numbers_and_frames_that_cannot_be() {
    Broken::new()
        .edit(|t| t["frames"][1]["transform_matrix"][0][0] = Value::from(1.9))
        .refused(&["transforms.json", "frame 1"], &[]);
    Broken::new().edit(|t| t["frames"] = Value::Array(Vec::new())).refused(&["transforms.json"], &[]);
    let b = Broken::new();
    let text = fs::read_to_string(b.path("transforms.json")).unwrap();
    fs::write(b.path("transforms.json"), text.replacen("\"frames\"", "\"k1\": NaN, \"frames\"", 1)).unwrap();
    b.refused(&["transforms.json"], &[]);
}

#[test]
fn depth_without_a_measurement_and_masks_for_some_frames_only() {
    let b = Broken::new();
    for entry in fs::read_dir(b.path("depth")).unwrap() {
        blank_png(&entry.unwrap().path(), 320, 200);
    }
    b.refused(&["depth"], &[]);
    let b = Broken::new();
    fs::create_dir_all(b.path("masks")).unwrap();
    blank_png(&b.path("masks/000000.png"), 320, 200);
    b.edit(|t| t["frames"][0]["mask_path"] = Value::from("masks/000000.png"));
    b.refused(&["mask"], &["--masks", "files"]);
}

#[test]
fn masks_by_networks_without_networks_or_their_weights() {
    let b = Broken::new();
    let empty = b.dir.path().join("weights");
    fs::create_dir(&empty).unwrap();
    let words =
        if cfg!(feature = "nets") { ["config.json", "google/owlv2"] } else { ["--masks", "--features nets"] };
    b.refused(&words, &["--masks", "sam2", "--weights", empty.to_str().unwrap()]);
    if cfg!(feature = "nets") {
        b.refused(&["--box", "no area"], &["--masks", "sam2", "--box", "mug=9,9,3,3"]);
        b.refused(&["sam3", "sam2-tiny"], &["--masks", "sam2", "--sam2", "sam3"]);
    }
}

#[test]
fn settings_with_an_unknown_key() {
    let b = Broken::new();
    let settings = b.dir.path().join("mine.toml");
    fs::write(&settings, "[scan]\nsteps_frst = 3\n").unwrap();
    b.refused(&["mine.toml", "steps_frst"], &["--settings", settings.to_str().unwrap()]);
    fs::write(&settings, "[scna]\n").unwrap();
    b.refused(&["mine.toml", "scna"], &["--settings", settings.to_str().unwrap()]);
}

#[test]
fn settings_that_cannot_be_leave_a_run_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let scan = |more: &[&str]| quick_scan(recording(), &run, more);
    let first = scan(&[]);
    assert!(first.status.success(), "{}", String::from_utf8_lossy(&first.stderr));
    let settings: toml::Table = toml::from_str(&fs::read_to_string(run.join("run.toml")).unwrap()).unwrap();
    assert_eq!(settings["scan"]["fused"]["steps"].as_integer(), Some(20), "{settings}");
    let before = contents(&run);
    for (given, words) in [
        ("scan.final_stps=500", &["`final_steps`", "--set scan.final_stps=500"][..]),
        ("scan.final_steps=many", &["final_steps", "type", "--set scan.final_steps=many"]),
        ("scan.batch_steps=0", &["`scan.batch_steps`"]),
        ("scan.seeding.spacing_px=nan", &["`scan.seeding.spacing_px`"]),
        ("scan.train.rates.color=-1", &["`scan.train.rates.color`"]),
        ("frames.long_side=1000000", &["`frames.long_side`", "16384"]),
        ("frames.stride=0", &["`frames.stride`"]),
        ("masks.voxel_m=0", &["`masks.voxel_m`"]),
        ("read.max_depth_m=inf", &["`read.max_depth_m`"]),
        ("entities.sphere.samples=0", &["`entities.sphere.samples`"]),
        ("scan.holdout=1", &["holdout"]),
    ] {
        expect_refusal(&scan(&["--set", given]), words);
        expect_refusal(&scan(&["--set", given, "--force"]), words);
    }
    expect_refusal(&scan(&["--holdout", "1"]), &["holdout"]);
    assert_eq!(contents(&run), before);
}

/// Every file of a folder with its bytes.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(contents(&path));
        } else {
            found.push((path.clone(), fs::read(&path).unwrap()));
        }
    }
    found.sort();
    found
}

#[test]
fn the_listed_settings_are_a_settings_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("all.toml");
    let listed = sms(&["settings", "--preset", "fine", "--set", "scan.holdout=8"]);
    assert!(listed.status.success());
    fs::write(&path, &listed.stdout).unwrap();
    let text = String::from_utf8(listed.stdout).unwrap();
    assert!(text.contains("long_side = 640") && text.contains("holdout = 8"), "{text}");
    let again = sms(&["settings", "--settings", path.to_str().unwrap()]);
    assert_eq!(String::from_utf8(again.stdout).unwrap(), text);
}

#[test]
fn the_settings_as_json_have_every_section() {
    let listed = sms(&["settings", "--json", "--set", "landing.draws=24"]);
    let values: Value = serde_json::from_slice(&listed.stdout).unwrap();
    for (name, _) in sms_pipeline::settings::SECTIONS {
        assert!(values[name].is_object(), "{name}");
    }
    assert_eq!((&values["landing"]["draws"], &values["flight"]["period_s"]), (&24.into(), &0.05.into()));
}

#[test]
fn a_missing_task_file_is_not_called_a_settings_file() {
    let dir = tempfile::tempdir().unwrap();
    let [run, task] = ["run", "nowhere.toml"].map(|name| dir.path().join(name));
    let output = sms(&["plan", run.to_str().unwrap(), "--task", task.to_str().unwrap()]);
    expect_refusal(&output, &["nowhere.toml", "task file"]);
    assert!(!String::from_utf8_lossy(&output.stderr).contains("settings"));
}

#[test]
fn a_gpu_that_is_missing_is_refused_before_any_work() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let device = if cfg!(feature = "gpu") { "gpu:4000" } else { "gpu" };
    expect_refusal(&quick_scan(recording(), &run, &["--device", device]), &["--device"]);
    assert!(!run.exists());
}

#[test]
fn a_run_in_the_folder_of_its_recording() {
    let b = Broken::new();
    let recording = b.dir.path().join("recording");
    let before = contents(&recording);
    for run in [recording.clone(), recording.join("run"), recording.join("depth/..")] {
        expect_refusal(&quick_scan(&recording, &run, &[]), &[run.to_str().unwrap(), "--out"]);
    }
    assert!(contents(&recording) == before, "the recording has changed");
}

#[test]
fn a_folder_that_holds_something_else_is_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("thesis.tex"), "do not touch").unwrap();
    expect_refusal(&sms(&["sample", dir.path().to_str().unwrap()]), &[dir.path().to_str().unwrap()]);
    expect_refusal(
        &sms(&["demo", "billiards", "--out", dir.path().to_str().unwrap()]),
        &[dir.path().to_str().unwrap()],
    );
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn a_fault_that_the_check_finds_is_an_exit_code_and_in_the_json() {
    let good = sms(&["check", recording().to_str().unwrap(), "--json"]);
    assert_eq!(good.status.code(), Some(0), "{}", String::from_utf8_lossy(&good.stderr));
    let report: Value = serde_json::from_slice(&good.stdout).unwrap();
    assert_eq!(report["check.approved"], Value::Bool(true));

    let b = Broken::new();
    b.edit(|t| {
        t["depth_unit_scale_factor"] = Value::from(t["depth_unit_scale_factor"].as_f64().unwrap() * 10.0)
    });
    let recording = b.dir.path().join("recording");
    let bad = sms(&["check", recording.to_str().unwrap(), "--json"]);
    assert_eq!(bad.status.code(), Some(1), "{}", String::from_utf8_lossy(&bad.stderr));
    let report: Value = serde_json::from_slice(&bad.stdout).unwrap();
    assert_eq!(report["check.approved"], Value::Bool(false));
    let findings = report["check.findings"].as_array().unwrap();
    let fault = findings.iter().find(|f| f["severity"] == "fault").unwrap();
    assert!(fault["cure"].as_str().unwrap().contains("depth_unit_scale_factor"), "{fault}");
    assert_eq!(sms(&["check", recording.to_str().unwrap()]).status.code(), Some(1));
}

/// A scan of few steps.
fn quick_scan(recording: &Path, run: &Path, more: &[&str]) -> Output {
    let mut arguments = vec!["scan", recording.to_str().unwrap(), "--out", run.to_str().unwrap()];
    arguments.extend(["--preset", "draft", "--set", "scan.fused.steps=20"]);
    arguments.extend(more);
    sms(&arguments)
}

#[test]
fn any_seed_does_reports_only_read_and_damaged_files_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let seed = u64::MAX.to_string();
    let scanned = quick_scan(recording(), &run, &["--seed", &seed]);
    assert!(scanned.status.success(), "{}", String::from_utf8_lossy(&scanned.stderr));
    assert!(fs::read_to_string(run.join("run.toml")).unwrap().contains(&seed));

    // How often a checkpoint is written, and whether the check was skipped, change nothing: the stages stay as they are.
    let stamp = |name: &str| fs::metadata(run.join(name).join("stage.json")).unwrap().modified().unwrap();
    let before = (stamp("frames"), stamp("gaussians"));
    let more = ["--seed", &seed, "--no-check", "--set", "scan.checkpoint_seconds=60"];
    assert!(quick_scan(recording(), &run, &more).status.success());
    assert_eq!((stamp("frames"), stamp("gaussians")), before);

    // While another process writes to the run, a report of its current content can be written.
    let path = run.to_str().unwrap();
    let writer = sms_core::RunFolder::open(&run).unwrap();
    let report = sms(&["report", path]);
    assert!(report.status.success(), "{}", String::from_utf8_lossy(&report.stderr));
    expect_refusal(&sms(&["materialize", path]), &[path]);
    drop(writer);

    for name in ["warnings.json", "gaussians/losses.json"] {
        let file = run.join(name);
        let whole = fs::read(&file).unwrap();
        fs::write(&file, &whole[..whole.len() / 2]).unwrap();
        expect_refusal(&sms(&["report", path]), &[name.rsplit('/').next().unwrap()]);
        fs::remove_file(&file).unwrap();
        assert!(sms(&["report", path]).status.success());
        fs::write(&file, whole).unwrap();
    }
}

#[test]
fn a_refused_run_names_finished_stages_only_if_there_are_some() {
    let b = Broken::new();
    fs::remove_file(b.path("depth/000003.png")).unwrap();
    let (recording, out) = (b.dir.path().join("recording"), b.dir.path().join("run"));
    let refused = |out: &Path| {
        let output = sms(&["run", recording.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        expect_refusal(&output, &["000003.png"]);
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(!refused(&out).contains("finished stages"));
    let finished = CopiedRun::new();
    assert!(refused(Path::new(&finished.folder())).contains("finished stages"));
}

#[cfg(not(feature = "rerun"))]
#[test]
fn a_live_view_without_the_feature_says_which_build_has_it() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    expect_refusal(&quick_scan(recording(), &run, &["--live"]), &["--features rerun"]);
    expect_refusal(&quick_scan(recording(), &run, &["--live=127.0.0.1:9876"]), &["--features rerun"]);
    assert!(!run.exists());
}

#[test]
fn progress_as_json_lines_tells_frame_step_losses_and_time_left() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let output = Command::new(env!("CARGO_BIN_EXE_sms"))
        .args(["scan", recording().to_str().unwrap(), "--out", run.to_str().unwrap(), "--preset", "draft"])
        .args(["--progress", "json", "--set", "scan.fused.steps=30"])
        // Where there is none, the system's graphics libraries complain on standard error as they look for GPUs.
        .env("XDG_RUNTIME_DIR", dir.path())
        .output()
        .unwrap();
    assert!(output.status.success());
    let text = String::from_utf8(output.stderr).unwrap();
    let lines: Vec<Value> = text
        .lines()
        .filter(|l| !l.starts_with("warning"))
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    let parts = |event: &str| -> Vec<&str> {
        lines.iter().filter(|l| l["event"] == event).map(|l| l["part"].as_str().unwrap()).collect()
    };
    assert_eq!(parts("begin"), ["check", "load", "masks from geometry", "scan"]);
    assert_eq!(parts("end"), parts("begin"));
    let update = lines.iter().rfind(|l| l["event"] == "update" && l["part"] == "scan").unwrap();
    for key in [
        "done",
        "frame",
        "frames",
        "step",
        "steps",
        "color_l1",
        "depth_m",
        "segmentation",
        "loss",
        "gaussians",
    ] {
        assert!(update[key].is_number(), "{key}: {update}");
    }
    assert!(update["seconds_left"].as_f64().unwrap() >= 0.0);
}
