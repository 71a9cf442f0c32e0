//! Errors shared by every stage.

use std::path::{Path, PathBuf};

/// Invalid input by the user: a file, a value, a setting. The command line exits with code 2.
///
/// Every message names the file (or setting) and the cure.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{what}{}\n  in: {path}\n  cure: {cure}", .more.written_detail())]
pub struct InputError {
    /// The problem, in one clause.
    pub what: String,
    /// The file, folder or setting that is wrong.
    pub path: String,
    /// The cure.
    pub cure: String,
    more: Box<More>,
}

/// The optional parts of an [`InputError`], boxed to keep results small.
#[derive(Debug, Clone, Default)]
struct More {
    detail: Option<String>,
    key: Option<String>,
}

impl More {
    fn written_detail(&self) -> String {
        self.detail.as_ref().map(|d| format!(" ({d})")).unwrap_or_default()
    }
}

impl InputError {
    /// Creates an input error about `path`.
    pub fn new(what: impl Into<String>, path: impl AsRef<Path>, cure: impl Into<String>) -> Self {
        let path = path.as_ref().display().to_string();
        Self { what: what.into(), path, cure: cure.into(), more: Box::default() }
    }

    /// The same error, attributed to a setting (`section.key`).
    #[must_use]
    pub fn at_key(mut self, key: impl Into<String>) -> Self {
        self.more.key = Some(key.into());
        self
    }

    /// Adds the underlying reason.
    pub fn because(mut self, detail: impl std::fmt::Display) -> Self {
        self.more.detail = Some(detail.to_string());
        self
    }

    /// The same error, about another file, folder or setting.
    #[must_use]
    pub fn at_path(self, path: impl AsRef<Path>) -> Self {
        Self { path: path.as_ref().display().to_string(), ..self }
    }

    /// The same error with another cure.
    #[must_use]
    pub fn with_cure(self, cure: impl Into<String>) -> Self {
        Self { cure: cure.into(), ..self }
    }

    /// Returns the underlying reason, if there is one.
    pub fn detail(&self) -> Option<&str> {
        self.more.detail.as_deref()
    }

    /// Returns the dotted key of the setting at fault (`scan.holdout`), if there is one.
    pub fn key(&self) -> Option<&str> {
        self.more.key.as_deref()
    }
}

/// The kinds of failure that callers treat differently.
#[derive(Debug, Clone, Copy)]
pub enum ErrorKind<'a> {
    /// Bad input, which the user can correct.
    Input(&'a InputError),
    /// The disk, or the user's quota, is full.
    DiskFull,
    /// The user asked to stop.
    Interrupted,
    /// Any other failure.
    Other,
}

/// An error of a stage with its kind.
pub trait StageError: std::error::Error {
    /// Returns the kind of failure.
    fn kind(&self) -> ErrorKind<'_>;

    /// Returns the bad input, if that is the cause.
    fn input(&self) -> Option<&InputError> {
        match self.kind() {
            ErrorKind::Input(error) => Some(error),
            _ => None,
        }
    }
}

impl StageError for InputError {
    fn kind(&self) -> ErrorKind<'_> {
        ErrorKind::Input(self)
    }
}

impl StageError for CoreError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) => ErrorKind::Input(e),
            Self::Write { source, .. } if is_disk_full(source) => ErrorKind::DiskFull,
            Self::Interrupted => ErrorKind::Interrupted,
            Self::Read { .. } | Self::Write { .. } => ErrorKind::Other,
        }
    }
}

fn is_disk_full(source: &std::io::Error) -> bool {
    matches!(source.kind(), std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded)
}

/// Errors of files, images, tables and the run folder.
#[derive(Debug, thiserror::Error)]
pub enum CoreError {
    /// Bad input by the user.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file could not be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file could not be written; the file that was there before is untouched.
    #[error("cannot write {path}: {source}{}", disk_full_hint(source))]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The user asked to stop; finished stages are kept and the run can be resumed.
    #[error("interrupted; run the same command again to resume")]
    Interrupted,
}

fn disk_full_hint(source: &std::io::Error) -> &'static str {
    match source.kind() {
        _ if is_disk_full(source) => {
            "; free some space and run the same command again: finished stages are kept"
        }
        std::io::ErrorKind::PermissionDenied => "; choose a folder that you may write to",
        _ => "",
    }
}

impl CoreError {
    /// Creates a read error, for `map_err`.
    pub fn read(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Read { path, source }
    }

    /// Creates a write error, for `map_err`.
    pub fn write(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Write { path, source }
    }
}
