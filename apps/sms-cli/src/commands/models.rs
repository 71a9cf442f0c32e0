//! `sms models`: lists and fetches the networks.

use crate::cli::ModelsArguments;
use sms_cli::front::Console;
use sms_pipeline::{fetch_models, list_models};

pub(crate) fn run(console: &Console, a: &ModelsArguments) -> anyhow::Result<()> {
    match a {
        ModelsArguments::List => {
            for m in list_models()? {
                let at = match m.cached {
                    Some((folder, commit)) => format!("{} (commit {commit})", folder.display()),
                    None => "not fetched".into(),
                };
                console.say(format!("{:15} {:40} {}\n{:15} {at}", m.name, m.repository, m.about, ""));
            }
        }
        ModelsArguments::Fetch { models } => drop(fetch_models(models, &console.context)?),
    }
    Ok(())
}
