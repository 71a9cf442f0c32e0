//! The masks of a run, to look at.

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
    /// [`Error::Input`] when there are none.
    pub fn masks(&self) -> Result<Labels, Error> {
        let masks = self.folder.join("masks");
        if !masks.join("labels.json").is_file() {
            let cure = "give the folder of a run: `sms scan RECORDING --out RUN` makes one";
            return Err(InputError::new("there are no masks here", &self.folder, cure).into());
        }
        Ok(load_labels(&masks)?)
    }

    /// Writes `preview.png`, the first frame with its masks and detections, and returns its path.
    ///
    /// # Errors
    /// [`Error::Core`] when a file cannot be read or written.
    pub fn preview_masks(&self, labels: &Labels) -> Result<PathBuf, Error> {
        write_masks_preview(&self.folder, labels)
    }

    /// Detects objects in the first frame, reports them as events and writes `preview.png`; no mask is changed.
    ///
    /// # Errors
    /// [`Error::Input`] for bad choices, or in a build without networks.
    pub fn preview_detections(&self, request: &NetworksRequest) -> Result<(), Error> {
        let sequence = Sequence::load(&self.folder.join("frames"))?;
        let read = self.context.settings.section("read", ReadOptions::default())?;
        Networks::new(request, Device::Auto, &read)?.preview(self.context, &sequence, &self.folder)
    }
}
