//! `sms sample`: writes a small generated recording with a task.

use crate::cli::SampleArguments;
use sms_cli::front::Console;
use sms_core::{InputError, Seed, counted, shell_argument};
use sms_pipeline::write_task_files;
use sms_synth::{BilliardsSettings, RecordingSettings, generate_billiards, write_recording};

pub(crate) fn run(console: &Console, a: &SampleArguments) -> anyhow::Result<()> {
    let occupied = a.folder.read_dir().is_ok_and(|mut entries| entries.next().is_some());
    if occupied && !a.folder.join("transforms.json").is_file() {
        return Err(InputError::new("this folder is not empty", &a.folder, "name a new folder").into());
    }
    let truth = generate_billiards(Seed(a.seed), &BilliardsSettings::default());
    let settings = RecordingSettings { seed: Seed(a.seed), ..RecordingSettings::small() };
    let context = &console.context;
    write_recording(&truth, &settings, &a.folder, context.progress.as_ref(), &context.cancel)?;
    write_task_files(&truth, &a.folder)?;
    console.say(format!(
        "wrote a recording of {} to {}; next steps:",
        counted(truth.objects.len(), "object", "objects"),
        a.folder.display()
    ));
    let folder = shell_argument(&a.folder);
    let task = shell_argument(&a.folder.join("task.toml"));
    console.say(format!("  sms run {folder} --out my-run --preset draft --task {task}"));
    console.say("or stage by stage:");
    console.say(format!("  sms check {folder}"));
    console.say(format!("  sms scan {folder} --out my-run --preset draft --holdout 8"));
    console.say("  sms materialize my-run");
    console.say("  sms simulate my-run");
    console.say(format!("  sms plan my-run --task {task}"));
    console.say("  sms execute my-run");
    console.say("  sms evaluate my-run");
    console.say("  sms view my-run");
    Ok(())
}
