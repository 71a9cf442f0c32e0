//! `sms name`: renames the objects of a run, asks a model for their names, or lists them.

use crate::cli::NameArguments;
use sms_cli::front::Console;
use sms_core::InputError;
use sms_core::metrics::Metrics;
use sms_pipeline::{NamedObjects, Rename, Run};

pub(crate) fn run(console: &Console, a: &NameArguments) -> anyhow::Result<()> {
    let renames = a.names.iter().map(|text| rename(text)).collect::<Result<Vec<_>, _>>()?;
    let run = Run::new(&a.run, &console.context);
    let named = if a.ask {
        run.rename_and_ask(&renames)?
    } else {
        NamedObjects { objects: run.rename(&renames)?, renames, warnings: Vec::new() }
    };
    for Rename { from, to, description } in &named.renames {
        let about = description.as_ref().map(|text| format!(" ({text})")).unwrap_or_default();
        console.say(format!("{from} is {to} now{about}"));
    }
    named.warnings.iter().for_each(|warning| console.warn(warning));
    if console.json {
        let mut metrics = Metrics::new();
        for object in &named.objects {
            metrics.set(format!("names.{}", object.id), object.name.clone());
        }
        return console.print_json(&metrics);
    }
    if a.names.is_empty() && !a.ask {
        for object in &named.objects {
            let merged = object.merge_into.as_ref().map(|host| format!("part of {host}"));
            let about = merged.unwrap_or_else(|| object.description.clone());
            console.say(format!("{:3} {:24} {about}", object.id, object.name).trim_end());
        }
    }
    console.say_next(&run)
}

fn rename(text: &str) -> Result<Rename, InputError> {
    match text.split_once('=') {
        Some((from, to)) => Ok(Rename::new(from.trim(), to.trim())),
        None => Err(InputError::new(
            "this is not a renaming",
            text,
            "write OBJECT=NAME, such as object_03=duck; `sms name RUN` lists the objects",
        )),
    }
}
