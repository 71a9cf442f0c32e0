//! `sms export`: the scene for another simulator.

use super::shown;
use crate::cli::{Export, FormatName};
use crate::context::Context;
use sms_core::RunFolder;
use sms_scene::{load_scene, write_mjcf};

pub(crate) fn run(context: &Context, a: &Export) -> anyhow::Result<()> {
    let run = RunFolder::open_to_read(&a.run)?;
    let scene = load_scene(&run.stage_dir("scene", "materialize")?)?;
    match a.format {
        FormatName::Mjcf => {
            let dir = a.out.clone().unwrap_or_else(|| run.root().join("export").join("mjcf"));
            write_mjcf(&dir, &scene)?;
            context.say(format!(
                "{}: {} bodies for MuJoCo",
                shown(&dir.join("scene.xml")),
                scene.bodies.len()
            ));
        }
    }
    context.print_metrics(&run)
}
