//! `sms manual` (hidden): shell completions and man pages, generated from the arguments for archives and packages.

use crate::cli::{Arguments, ManualArguments};
use anyhow::Context;
use clap::{CommandFactory, ValueEnum};
use clap_complete::Shell;
use sms_cli::front::Console;
use std::fs;

pub(crate) fn run(console: &Console, a: &ManualArguments) -> anyhow::Result<()> {
    let (completions, man) = (a.folder.join("completions"), a.folder.join("man"));
    for folder in [&completions, &man] {
        fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    for &shell in Shell::value_variants() {
        clap_complete::generate_to(shell, &mut Arguments::command(), "sms", &completions)
            .with_context(|| format!("cannot write {}", completions.display()))?;
    }
    clap_mangen::generate_to(Arguments::command(), &man)
        .with_context(|| format!("cannot write {}", man.display()))?;
    console.say(format!("completions and man pages: {}", a.folder.display()));
    Ok(())
}
