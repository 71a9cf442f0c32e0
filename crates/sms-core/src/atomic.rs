//! Atomic writes: files are written to a temporary name in the same folder, then renamed.

use crate::{CoreError, InputError};
use serde::{Serialize, de::DeserializeOwned};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

fn temporary_name(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.tmp", std::process::id()));
    path.with_file_name(name)
}

/// Writes a file through `fill`; an existing file stays whole until the new one is complete.
///
/// # Errors
/// [`CoreError::Write`] when the folder cannot be made or the disk is full; the temporary file is removed.
pub fn write_with(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), CoreError> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(CoreError::write(folder))?;
    }
    let temporary = temporary_name(path);
    let written = (|| {
        let mut writer = BufWriter::with_capacity(1 << 16, File::create(&temporary)?);
        fill(&mut writer)?;
        let file = writer.into_inner().map_err(|e| e.into_error())?;
        file.sync_all()?;
        std::fs::rename(&temporary, path)
    })();
    written.map_err(|source| {
        // Best effort: the write error is reported.
        let _ = std::fs::remove_file(&temporary);
        CoreError::Write { path: path.to_owned(), source }
    })
}

/// Writes bytes atomically.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), CoreError> {
    write_with(path, |w| w.write_all(bytes))
}

/// Writes pretty JSON atomically, with a final newline.
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<(), CoreError> {
    write_with(path, |w| {
        serde_json::to_writer_pretty(&mut *w, value).map_err(std::io::Error::other)?;
        w.write_all(b"\n")
    })
}

/// Reads JSON.
///
/// # Errors
/// [`CoreError::Read`] when the file cannot be read, [`CoreError::Input`] when its content does not match the type.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, CoreError> {
    let text = std::fs::read_to_string(path).map_err(CoreError::read(path))?;
    serde_json::from_str(&text).map_err(|e| {
        let what = "this JSON file does not have the expected content";
        InputError::new(what, path, "restore or regenerate the file").because(e).into()
    })
}

/// Reads TOML; unknown keys are errors if the type denies them.
///
/// # Errors
/// As [`read_toml_as`].
pub fn read_toml<T: DeserializeOwned>(path: &Path) -> Result<T, CoreError> {
    read_toml_as(path, "file")
}

/// Reads TOML; messages call the file `what` ("settings file", "task file").
///
/// # Errors
/// [`CoreError::Input`] when the file does not exist, cannot be read, is not TOML, or does not match the type.
pub fn read_toml_as<T: DeserializeOwned>(path: &Path, what: &str) -> Result<T, CoreError> {
    let text = std::fs::read_to_string(path).map_err(|e| {
        if e.kind() == std::io::ErrorKind::NotFound {
            return InputError::new(format!("this {what} does not exist"), path, "check the path");
        }
        let fault = format!("this {what} cannot be read");
        InputError::new(fault, path, "check the path and its permissions").because(e)
    })?;
    toml::from_str(&text).map_err(|e| {
        let reason = e.to_string();
        let cure = if reason.contains("missing field") {
            "add the missing key"
        } else if reason.contains("unknown field") {
            "use one of the keys listed above"
        } else {
            "correct the line named above"
        };
        InputError::new(format!("this {what} has an error"), path, cure)
            .because(format!("\n{}", reason.trim_end()))
            .into()
    })
}

/// Removes temporary files that a killed process left in `folder` (not in its sub-folders).
pub fn remove_leftovers(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        if entry.path().extension().is_some_and(|e| e == "tmp") {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_temporary() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.json");
        write_bytes(&path, b"old").unwrap();
        let failed = write_with(&path, |w| {
            w.write_all(b"half")?;
            Err(std::io::Error::from(std::io::ErrorKind::StorageFull))
        });
        let Err(CoreError::Write { source, .. }) = failed else { panic!("{failed:?}") };
        assert_eq!(source.kind(), std::io::ErrorKind::StorageFull);
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn files_are_called_by_their_kind() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("task.toml");
        let read = || read_toml_as::<toml::Table>(&path, "task file");
        let Err(CoreError::Input(missing)) = read() else { panic!("there is no file") };
        assert_eq!(missing.path, path.display().to_string());
        std::fs::write(&path, "kind = ").unwrap();
        let Err(CoreError::Input(broken)) = read() else { panic!("this is not TOML") };
        for error in [missing, broken] {
            assert!(error.what.contains("task file") && !error.what.contains("settings"), "{error}");
        }
        std::fs::write(&path, "kind = 1").unwrap();
        assert_eq!(read().unwrap()["kind"].as_integer(), Some(1));
    }
}
