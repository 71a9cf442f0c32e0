//! `--live`: who watches a scan.

use sms_gaussians::{BatchDone, ScanObserver, SlotDone};
use std::path::Path;

/// Who watches; nobody without `--live`.
pub(crate) struct Watch {
    #[cfg(feature = "rerun")]
    viewer: Option<sms_report::LiveScan>,
}

#[cfg(feature = "rerun")]
impl Watch {
    /// What `--live[=ADDR]` asks for.
    pub(crate) fn start(address: Option<&str>, recording: &Path) -> anyhow::Result<Self> {
        let Some(address) = address else { return Ok(Self { viewer: None }) };
        let viewer = match address {
            "auto" => sms_report::Viewer::Any,
            given => sms_report::Viewer::At(given.to_owned()),
        };
        let name = recording.file_name().map_or_else(|| "scan".into(), |n| n.to_string_lossy().into_owned());
        match sms_report::LiveScan::start(&viewer, &name) {
            Ok(scan) => Ok(Self { viewer: Some(scan) }),
            // As such, so that the exit code is that of bad input.
            Err(sms_report::LiveError::Input(e)) => Err(e.into()),
            Err(other) => Err(other.into()),
        }
    }

    /// Waits until the viewer has everything; what went wrong, if anything did.
    pub(crate) fn finish(self) -> Option<String> {
        self.viewer.and_then(|v| v.finish().err()).map(|e| e.to_string())
    }
}

#[cfg(not(feature = "rerun"))]
impl Watch {
    /// Without the feature there is no viewer to stream to.
    pub(crate) fn start(address: Option<&str>, _recording: &Path) -> anyhow::Result<Self> {
        match address {
            None => Ok(Self {}),
            Some(_) => Err(sms_core::InputError::new(
                "this `sms` was built without the Rerun viewer",
                "--live",
                "build it with the feature (some ten minutes): cargo install --path apps/sms-cli --features rerun",
            )
            .into()),
        }
    }

    /// Nothing can have gone wrong.
    pub(crate) fn finish(self) -> Option<String> {
        None
    }
}

impl ScanObserver for Watch {
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
