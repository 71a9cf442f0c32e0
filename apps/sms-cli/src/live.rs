//! `--live`: streaming of a scan to a viewer.

use sms_gaussians::{BatchDone, ScanObserver, SlotDone};
use std::path::Path;

/// Observer of a scan; does nothing without `--live`.
pub(crate) struct Watch {
    #[cfg(feature = "rerun")]
    viewer: Option<sms_report::LiveScan>,
}

#[cfg(feature = "rerun")]
impl Watch {
    /// Starts the viewer of `--live[=ADDR]`.
    pub(crate) fn start(address: Option<&str>, recording: &Path) -> anyhow::Result<Self> {
        let Some(address) = address else { return Ok(Self { viewer: None }) };
        let viewer = match address {
            "auto" => sms_report::Viewer::Any,
            given => sms_report::Viewer::At(given.to_owned()),
        };
        let name = recording.file_name().map_or_else(|| "scan".into(), |n| n.to_string_lossy().into_owned());
        match sms_report::LiveScan::start(&viewer, &name) {
            Ok(scan) => Ok(Self { viewer: Some(scan) }),
            // Returned as `InputError`, so that the exit code is that of bad input.
            Err(sms_report::LiveError::Input(e)) => Err(e.into()),
            Err(other) => Err(other.into()),
        }
    }

    /// Waits until the viewer has received all data; returns the error, if any.
    pub(crate) fn finish(self) -> Option<String> {
        self.viewer.and_then(|v| v.finish().err()).map(|e| e.to_string())
    }
}

#[cfg(not(feature = "rerun"))]
impl Watch {
    /// Returns an error for `--live`, which needs the feature `rerun`.
    pub(crate) fn start(address: Option<&str>, _recording: &Path) -> anyhow::Result<Self> {
        match address {
            None => Ok(Self {}),
            Some(_) => Err(sms_core::InputError::new(
                "this `sms` was built without the Rerun viewer",
                "--live",
                "build it with the feature (about ten minutes): cargo install --locked --path apps/sms-cli --features rerun",
            )
            .into()),
        }
    }

    /// Returns no error.
    pub(crate) fn finish(self) -> Option<String> {
        None
    }
}

impl ScanObserver for Watch {
    fn completed(&mut self) {
        #[cfg(feature = "rerun")]
        if let Some(viewer) = &mut self.viewer {
            viewer.completed();
        }
    }

    fn batch(&mut self, batch: &BatchDone) {
        #[cfg(feature = "rerun")]
        if let Some(viewer) = &mut self.viewer {
            viewer.batch(batch);
        }
        let _ = batch;
    }

    fn slot(&mut self, slot: &SlotDone<'_>) {
        #[cfg(feature = "rerun")]
        if let Some(viewer) = &mut self.viewer {
            viewer.slot(slot);
        }
        let _ = slot;
    }
}
