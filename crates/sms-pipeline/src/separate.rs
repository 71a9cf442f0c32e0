//! Keeps runs out of the folders of their recordings.

use crate::Error;
use sms_core::{CoreError, InputError, shell_argument};
use std::path::{Path, PathBuf};

/// Refuses a run that is its recording's folder or lies in it: the stages of the run would lie among the images, and a
/// copy of the recording would hold the run.
///
/// # Errors
/// [`Error::Input`]; [`Error::Core`] if the current folder is unknown.
pub(crate) fn refuse_run_in_recording(run: &Path, recording: &Path) -> Result<(), Error> {
    let (real_run, real_recording) = (real(run)?, real(recording)?);
    if !real_run.starts_with(&real_recording) {
        return Ok(());
    }
    let what = if real_run == real_recording {
        "the folder of the run is the recording's own"
    } else {
        "the folder of the run lies in the recording's"
    };
    let name = real_recording.file_name().map_or_else(|| "my".into(), |name| name.to_string_lossy());
    let beside = real_recording.with_file_name(format!("{name}-run"));
    let cure = format!("name a folder outside of the recording, such as --out {}", shell_argument(&beside));
    Err(InputError::new(what, run, cure).into())
}

/// Returns the path without links and `..`; what does not exist yet is appended as it is.
fn real(path: &Path) -> Result<PathBuf, CoreError> {
    let absolute = std::path::absolute(path).map_err(CoreError::read(path))?;
    let known = |folder: &Path| {
        let rest = absolute.strip_prefix(folder).ok()?;
        let folder = folder.canonicalize().ok()?;
        // Joining an empty path would add a separator.
        Some(if rest.as_os_str().is_empty() { folder } else { folder.join(rest) })
    };
    Ok(absolute.ancestors().find_map(known).unwrap_or(absolute.clone()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::StageError;

    #[test]
    fn a_run_may_hold_its_recording_but_not_lie_in_it() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir_all(at("rec/depth")).unwrap();
        let is_refused = |run: &str, recording: &str| {
            let result = refuse_run_in_recording(&at(run), &at(recording));
            result.is_err_and(|e| e.input().is_some())
        };
        for run in ["rec", "rec/", "rec/run", "rec/depth/new/run", "rec/../rec", "rec/depth/.."] {
            assert!(is_refused(run, "rec"), "{run}");
        }
        for run in ["run", "rec-run", "rec/../run", ".", "new/rec"] {
            assert!(!is_refused(run, "rec"), "{run}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(at("rec"), at("link")).unwrap();
            assert!(
                is_refused("link", "rec") && is_refused("rec/run", "link") && is_refused("link/run", "rec")
            );
        }
    }
}
