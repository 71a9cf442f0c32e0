//! `sms name`: renames the objects of a run, or lists them.

use crate::cli::NameArguments;
use sms_cli::front::Console;
use sms_core::InputError;
use sms_core::metrics::Metrics;
use sms_pipeline::Run;

pub(crate) fn run(console: &Console, a: &NameArguments) -> anyhow::Result<()> {
    let renames = a.names.iter().map(|text| pair(text)).collect::<Result<Vec<_>, _>>()?;
    let run = Run::new(&a.run, &console.context);
    let objects = run.rename(&renames)?;
    if console.json {
        let mut metrics = Metrics::new();
        for object in &objects {
            metrics.set(format!("names.{}", object.id), object.name.clone());
        }
        return console.print_json(&metrics);
    }
    for (from, to) in &renames {
        console.say(format!("{from} is {to} now"));
    }
    if renames.is_empty() {
        for object in &objects {
            let merged = object.merge_into.as_ref().map(|host| format!("part of {host}"));
            let about = merged.unwrap_or_else(|| object.description.clone());
            console.say(format!("{:3} {:24} {about}", object.id, object.name).trim_end());
        }
    }
    console.say_next(&run)
}

fn pair(text: &str) -> Result<(String, String), InputError> {
    match text.split_once('=') {
        Some((from, to)) => Ok((from.trim().to_owned(), to.trim().to_owned())),
        None => Err(InputError::new(
            "this is not a renaming",
            text,
            "write OBJECT=NAME, such as object_03=duck; `sms name RUN` lists the objects",
        )),
    }
}
