//! Access to the masks of a run.

use super::Run;
use crate::networks::Networks;
use crate::preview::write_masks_preview;
use crate::{Device, Error, NetworksRequest};
use sms_core::{InputError, Labels};
use sms_frames::{ReadOptions, Sequence};
use sms_masks::load_labels;
use std::path::PathBuf;

impl Run<'_> {
    /// Reads the masks.
    ///
    /// # Errors
    /// [`Error::Input`] if there are none.
    pub fn masks(&self) -> Result<Labels, Error> {
        let masks = self.folder.join("masks");
        if !masks.join("labels.json").is_file() {
            let cure = "use the folder of a run, which `sms scan RECORDING --out RUN` creates";
            return Err(InputError::new("this folder has no masks", &self.folder, cure).into());
        }
        Ok(load_labels(&masks)?)
    }

    /// Writes `preview.png`, the first frame with its masks and detections, and returns its path.
    ///
    /// # Errors
    /// [`Error::Core`] if a file cannot be read or written.
    pub fn preview_masks(&self, labels: &Labels) -> Result<PathBuf, Error> {
        write_masks_preview(&self.folder, labels)
    }

    /// Detects objects in the first frame, reports them as events and writes `preview.png`, without changing the masks.
    ///
    /// # Errors
    /// [`Error::Input`] for invalid options, or in a build without networks.
    pub fn preview_detections(&self, request: &NetworksRequest) -> Result<(), Error> {
        let sequence = Sequence::load(&self.folder.join("frames"))?;
        let read = self.context.settings.section("read", ReadOptions::default())?;
        Networks::new(request, Device::Auto, &read)?.preview(self.context, &sequence, &self.folder)
    }
}
