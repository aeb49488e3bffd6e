//! `penumbra completions` and `penumbra manual`: the command line for shells and `man`.

use std::path::PathBuf;

use clap::Command;
use clap_complete::Shell;
use penumbra::{Error, Result};

use super::{Ending, print};

#[derive(clap::Args)]
pub struct Completions {
    /// Shell to complete for
    shell: Shell,
}

#[derive(clap::Args)]
pub struct Manual {
    /// Folder for the pages: one for the program and one for each command
    folder: PathBuf,
}

pub fn completions(arguments: &Completions, mut command: Command) -> Result<Ending> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "penumbra", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(Ending::Done)
}

pub fn manual(arguments: &Manual, command: Command) -> Result<Ending> {
    clap_mangen::generate_to(command, &arguments.folder)
        .map_err(|problem| Error::output(&arguments.folder, problem))?;
    Ok(Ending::Done)
}
