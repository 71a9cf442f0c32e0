//! Exports the scene for other simulators.

use super::Run;
use crate::Error;
use sms_export::{Format, Sources, export};
use sms_scene::load_scene;
use std::path::{Path, PathBuf};

impl Run<'_> {
    /// Writes the scene in these formats and returns the main file of each. The folder is `export/FORMAT` in the run by
    /// default; with several formats, each has a subfolder of `out`.
    ///
    /// # Errors
    /// [`Error::Core`] if there is no scene or a file cannot be written.
    pub fn export(&self, formats: &[Format], out: Option<&Path>) -> Result<Vec<PathBuf>, Error> {
        let run = self.open_to_read()?;
        let dir = run.stage_dir("scene", "materialize")?;
        self.warn_stale(&run, "scene");
        let scene = load_scene(&dir)?;
        let sources = Sources { gaussians: Some(dir.join("gaussians")) };
        let target = |format: Format| match out {
            Some(out) if formats.len() > 1 => out.join(format.name()),
            Some(out) => out.to_owned(),
            None => run.root().join("export").join(format.name()),
        };
        let written = formats.iter().map(|&f| export(&scene, f, &sources, &target(f)));
        Ok(written.collect::<Result<_, _>>()?)
    }
}
