//! Atomic replacement of folders.

use sms_core::{CoreError, InputError};
use std::fs;
use std::path::{Path, PathBuf};

/// The file that marks an export; only a folder with it (or an empty one) is replaced.
pub(crate) const MANIFEST: &str = "bodies.json";

fn sibling(dir: &Path, suffix: &str) -> PathBuf {
    let mut name = std::ffi::OsString::from(".");
    name.push(dir.file_name().unwrap_or_default());
    name.push(format!(".{}.{suffix}", std::process::id()));
    dir.with_file_name(name)
}

fn is_replaceable(dir: &Path) -> std::io::Result<bool> {
    Ok(dir.join(MANIFEST).is_file() || fs::read_dir(dir)?.next().is_none())
}

/// Replaces `dir` by a folder that `fill` writes; if `fill` fails, the existing folder is kept.
///
/// # Errors
/// [`CoreError::Input`] when `dir` is a file, or a folder that holds something other than an earlier export;
/// [`CoreError::Write`]; the errors of `fill`.
pub(crate) fn write_folder(
    dir: &Path,
    fill: impl FnOnce(&Path) -> Result<(), CoreError>,
) -> Result<(), CoreError> {
    // Paths such as `out/.` have no sibling.
    let dir = &std::path::absolute(dir).map_err(CoreError::write(dir))?;
    let dir = &dir.components().collect::<PathBuf>();
    let cure = "name a new folder with --out";
    if dir.is_file() {
        return Err(InputError::new("this is a file, not a folder", dir, cure).into());
    }
    if dir.file_name().is_none() {
        return Err(InputError::new("this folder cannot be replaced by an export", dir, cure).into());
    }
    if dir.is_dir() && !is_replaceable(dir).map_err(CoreError::read(dir))? {
        let what = "this folder holds other files than an earlier export, which would be lost";
        return Err(InputError::new(what, dir, cure).into());
    }
    let (work, old) = (sibling(dir, "partial"), sibling(dir, "old"));
    let clean = |path: &Path| if path.exists() { fs::remove_dir_all(path) } else { Ok(()) };
    clean(&work).map_err(CoreError::write(&work))?;
    clean(&old).map_err(CoreError::write(&old))?;
    fs::create_dir_all(&work).map_err(CoreError::write(&work))?;
    let written = fill(&work).and_then(|()| {
        if dir.exists() {
            fs::rename(dir, &old).map_err(CoreError::write(dir))?;
        }
        fs::rename(&work, dir).map_err(|e| {
            // Restores the earlier export if the new one could not be renamed.
            let _ = fs::rename(&old, dir);
            CoreError::Write { path: dir.clone(), source: e }
        })
    });
    if written.is_err() {
        // Best effort: the first error is reported.
        let _ = fs::remove_dir_all(&work);
    }
    written?;
    clean(&old).map_err(CoreError::write(&old))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fill(text: &'static str) -> impl FnOnce(&Path) -> Result<(), CoreError> {
        move |dir| sms_core::atomic::write_bytes(&dir.join(MANIFEST), text.as_bytes())
    }

    #[test]
    fn a_failed_export_leaves_the_old_one_and_foreign_folders_are_refused() {
        let root = tempfile::tempdir().unwrap();
        let dir = root.path().join("mjcf");
        write_folder(&dir, fill("old")).unwrap();
        let failed = write_folder(&dir, |work| {
            fs::write(work.join("half"), "x").unwrap();
            Err(InputError::new("no", work, "no").into())
        });
        assert!(failed.is_err());
        let read = || fs::read_to_string(dir.join(MANIFEST)).unwrap();
        assert_eq!((read().as_str(), fs::read_dir(root.path()).unwrap().count()), ("old", 1));
        write_folder(&dir.join("."), fill("new")).unwrap();
        assert_eq!((read().as_str(), fs::read_dir(root.path()).unwrap().count()), ("new", 1));
        let photos = root.path().join("photos");
        fs::create_dir(&photos).unwrap();
        write_folder(&photos, fill("empty folders are fine")).unwrap();
        fs::remove_file(photos.join(MANIFEST)).unwrap();
        fs::write(photos.join("a.jpg"), "x").unwrap();
        assert!(matches!(write_folder(&photos, fill("x")), Err(CoreError::Input(_))));
        assert!(photos.join("a.jpg").exists());
    }
}
