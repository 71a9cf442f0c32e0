//! `sms status`: the stages of a run, and the next commands.

use crate::cli::StatusArguments;
use sms_cli::front::Console;
use sms_pipeline::Run;

pub(crate) fn run(console: &Console, a: &StatusArguments) -> anyhow::Result<()> {
    let status = Run::new(&a.run, &console.context).status()?;
    if console.json {
        return console.print_json(&status.metrics());
    }
    if let Some(recording) = &status.recording {
        console.say(format!("recording: {}", recording.display()));
    }
    for stage in &status.stages {
        let mut line = format!("{:>10}  {}", stage.name, stage.condition.name());
        if !stage.reasons.is_empty() {
            line += &format!(": {}", stage.reasons.join("; "));
        }
        if stage.is_interrupted {
            line += " (unfinished work is kept)";
        }
        console.say(line);
    }
    console.say(format!("next: {}", status.next.join("\n      ")));
    Ok(())
}
