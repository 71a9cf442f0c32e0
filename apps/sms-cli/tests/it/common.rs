//! Starts the program, and makes the recording and the run that several tests begin with.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// Runs the program with these arguments and without progress.
pub(crate) fn sms(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sms"));
    // Without a runtime folder, a software Vulkan driver adds lines to the errors.
    command.env("XDG_RUNTIME_DIR", std::env::temp_dir());
    command.args(arguments).arg("--quiet").output().expect("the program starts")
}

/// Runs the program, which must succeed, and returns its output.
pub(crate) fn done(arguments: &[&str]) -> String {
    let output = sms(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", said(&output));
    said(&output)
}

/// Returns the standard output and error of a run.
pub(crate) fn said(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|s| String::from_utf8_lossy(s).into_owned()).concat()
}

/// The generated recording of `sms sample`, made once for all tests; they only read it.
pub(crate) fn recording() -> &'static Path {
    static RECORDING: OnceLock<PathBuf> = OnceLock::new();
    RECORDING.get_or_init(|| {
        let path = shared_folder("recording");
        done(&["sample", path.to_str().unwrap()]);
        path
    })
}

/// Copies a materialized `draft` run of [`recording`] to `to`. The run is made once for all tests, with few steps
/// and points.
pub(crate) fn copy_materialized_run(to: &Path) {
    static RUN: OnceLock<PathBuf> = OnceLock::new();
    let made = RUN.get_or_init(|| {
        let path = shared_folder("run");
        let (run, recording) = (path.to_str().unwrap(), recording().to_str().unwrap());
        done(&["scan", recording, "--out", run, "--preset", "draft", "--set", "scan.fused.steps=100"]);
        done(&["materialize", run, "--set", "entities.point_budget=4000"]);
        path
    });
    copy(made, to);
}

/// A copy of the materialized run that a test may change.
pub(crate) struct CopiedRun {
    dir: tempfile::TempDir,
}

impl CopiedRun {
    pub(crate) fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        copy_materialized_run(&dir.path().join("run"));
        Self { dir }
    }

    /// The path of a file of the run.
    pub(crate) fn path(&self, of: &str) -> PathBuf {
        self.dir.path().join("run").join(of)
    }

    /// The run's folder as an argument.
    pub(crate) fn folder(&self) -> String {
        self.dir.path().join("run").to_str().unwrap().to_owned()
    }

    /// Runs a command on the run.
    pub(crate) fn run(&self, command: &str, more: &[&str]) -> Output {
        sms(&[&[command, &self.folder()], more].concat())
    }

    /// Runs a command, which must succeed, and returns its output.
    pub(crate) fn done(&self, command: &str, more: &[&str]) -> String {
        done(&[&[command, &self.folder()], more].concat())
    }

    /// Replaces the first occurrence of a text in `masks/labels.json`, which must be there.
    pub(crate) fn edit_labels(&self, from: &str, to: &str) {
        let path = self.path("masks/labels.json");
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{from} in {text}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
    }
}

/// Returns the path of a folder that does not exist. It lies in the target folder: a static temporary directory would
/// never be deleted.
fn shared_folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sms-cli-tests").join(name);
    match fs::remove_dir_all(&path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => panic!("{}: {e}", path.display()),
        _ => path,
    }
}

/// Copies a folder with everything in it.
pub(crate) fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}
