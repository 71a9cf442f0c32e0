//! Replacement of the networks in builds without the feature `nets`: every use is an error.

use super::{ModelEntry, NetworksRequest};
use crate::{Context, Device, Error};
use sms_core::InputError;
use sms_core::metrics::Metrics;
use sms_frames::{ReadOptions, Sequence};
use sms_masks::Segmenter;
use std::convert::Infallible;
use std::path::{Path, PathBuf};

/// Cannot be constructed.
pub(crate) struct Networks(Infallible);

impl Networks {
    pub(crate) fn new(_: &NetworksRequest, _: Device, _: &ReadOptions) -> Result<Self, Error> {
        Err(none().into())
    }

    pub(crate) fn settings(&self) -> Result<String, Error> {
        match self.0 {}
    }

    pub(crate) fn describe(&self, _: &mut Metrics) {
        match self.0 {}
    }

    pub(crate) fn segmenter<'a>(
        &'a self,
        _: &'a Context,
        _: &'a Path,
        _: &'a Path,
    ) -> Box<dyn Segmenter + 'a> {
        match self.0 {}
    }

    pub(crate) fn preview(&self, _: &Context, _: &Sequence, _: &Path) -> Result<(), Error> {
        match self.0 {}
    }
}

/// Lists the networks.
///
/// # Errors
/// [`Error::Input`]: this build has no networks.
pub fn list_models() -> Result<Vec<ModelEntry>, Error> {
    Err(none().into())
}

/// Fetches networks into the Hugging Face cache.
///
/// # Errors
/// [`Error::Input`]: this build has no networks.
pub fn fetch_models(_: &[String], _: &Context) -> Result<Vec<(String, PathBuf)>, Error> {
    Err(none().into())
}

fn none() -> InputError {
    InputError::new(
        "this build has no networks",
        "--masks sam2",
        "build with `cargo build --release --features nets`, or use --masks geometry",
    )
}
