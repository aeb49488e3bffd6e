//! The command line for shells and `man`: `penumbra completions`, `penumbra manual`, and commands to copy.

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

/// Words as one line that a shell reads.
pub fn quoted(words: &[String]) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:+@%".contains(c);
    let quote = |word: &String| match !word.is_empty() && word.chars().all(is_plain) {
        true => word.clone(),
        false => format!("'{}'", word.replace('\'', "'\\''")),
    };
    words.iter().map(quote).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn words_are_quoted_for_a_shell() {
        let words = ["--look-from=-1,0.5,2", "my scene.glb", "it's", ""].map(str::to_owned);
        assert_eq!(quoted(&words), "--look-from=-1,0.5,2 'my scene.glb' 'it'\\''s' ''");
    }
}
