//! `sms export`: the scene for another simulator.

use super::shown;
use crate::cli::{Export, FormatName};
use sms_cli::front::Console;
use sms_core::RunFolder;
use sms_export::{Format, Sources, export};
use sms_scene::load_scene;

pub(crate) fn run(console: &Console, a: &Export) -> anyhow::Result<()> {
    let run = RunFolder::open_to_read(&a.run)?;
    let dir = run.stage_dir("scene", "materialize")?;
    let scene = load_scene(&dir)?;
    let sources = Sources { gaussians: Some(dir.join("gaussians")) };
    let formats = chosen(&a.format);
    for &format in &formats {
        let dir = match &a.out {
            // Several formats share the folder, each in its own below it.
            Some(out) if formats.len() > 1 => out.join(format.name()),
            Some(out) => out.clone(),
            None => run.root().join("export").join(format.name()),
        };
        let main_file = export(&scene, format, &sources, &dir)?;
        console.say(format!("{}: {} bodies", shown(&main_file), scene.bodies.len()));
    }
    console.print_metrics(&run)
}

/// The formats that were asked for, each once, in the order of [`Format::ALL`].
fn chosen(names: &[FormatName]) -> Vec<Format> {
    let is_asked = |format: &Format| {
        names.iter().any(|name| match name {
            FormatName::Mjcf => *format == Format::Mjcf,
            FormatName::Urdf => *format == Format::Urdf,
            FormatName::Sdf => *format == Format::Sdf,
            FormatName::Usd => *format == Format::Usd,
            FormatName::Glb => *format == Format::Glb,
            FormatName::Obj => *format == Format::Obj,
            FormatName::All => true,
        })
    };
    Format::ALL.into_iter().filter(is_asked).collect()
}
