//! The command line: the one place that prints, listens to signals and sets the exit code.
//!
//! Results (a plan, devices, measures) go to stdout; errors, notes and progress to stderr.

mod cache;
mod check;
mod child;
mod compare;
mod devices;
mod first_samples;
mod flags;
mod folder;
mod interrupt;
mod merge;
mod options;
mod plan;
mod progress;
mod render;
mod report;
mod sequence;
mod shell;
mod stress;
mod table1;
#[cfg(feature = "view")]
mod view;

use std::fmt::Display;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
use flags::with_flags;
use interrupt::Interrupt;
use penumbra::internal::render::film;
use penumbra::{Error, Result};

/// Render glTF scenes with shadow photons, on a Vulkan device
#[derive(Parser)]
#[command(name = "penumbra", version, after_help = EXIT_CODES)]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Render a scene to images
    Render(Box<render::Arguments>),
    /// Merge pieces of an image made by `render --samples`
    Merge(merge::Arguments),

    /// Open a window in which a scene renders while you look around
    #[cfg(feature = "view")]
    View(Box<view::Arguments>),
    /// Print which features a render of the scene would use and which it would leave out, and why; renders nothing
    Plan(Box<plan::Arguments>),
    /// List the Vulkan devices
    Devices(devices::Arguments),
    /// Measure the error of an image against a reference
    Compare(compare::Arguments),
    /// Image regression tests: render cases and compare them with their baselines
    Check(Box<check::Arguments>),
    /// Compare techniques: plot their error over time, against a reference
    Report(Box<report::Arguments>),
    /// Repeat table 1 of the paper: two scenes with four techniques, printed beside the figures of the paper
    Table1(table1::Arguments),
    /// Render small scenes with extreme parameters, and print where an error exceeds its bound
    Stress(stress::Arguments),
    /// Print the completion script for a shell
    Completions(shell::Completions),
    /// Write the manual pages, for packages
    #[command(hide = true)]
    Manual(shell::Manual),
}

const EXIT_CODES: &str = "\
Exit codes:
  0    success
  1    the render failed
  2    wrong usage
  3    a file cannot be read, understood or written
  4    no Vulkan device, or the device was lost and could not be replaced; view: no display
  5    compare: the error is above the limit; check: a case did not pass
  130  stopped by Ctrl-C; render, after the finished samples were written, and report and check: also by SIGTERM
  143  stopped by SIGTERM before the first sample, by SIGTERM as the second signal, or in any other command";

/// How a command ended without an error.
enum Ending {
    Done,
    /// `compare`: the error is above the limit; `check`: a case did not pass.
    AboveLimit,
    /// Stopped by a signal. `render` has written the image so far, and `report` a report if there are enough runs for
    /// one. `check` has written nothing.
    Stopped,
}

/// Runs the program with the arguments of the process.
pub fn run() -> ExitCode {
    let command = match CommandLine::try_parse() {
        Ok(line) => line.command,
        Err(error) => return answer(&error),
    };
    // From here on, a signal must leave no half-written file.
    Interrupt::listen();
    let ending = match command {
        Command::Render(arguments) => render::run(&arguments),
        Command::Merge(arguments) => merge::run(&arguments),
        #[cfg(feature = "view")]
        Command::View(arguments) => view::run(&arguments),
        Command::Plan(arguments) => plan::run(&arguments),
        Command::Devices(arguments) => devices::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        Command::Table1(arguments) => table1::run(&arguments),
        Command::Stress(arguments) => stress::run(&arguments),
        Command::Completions(arguments) => shell::completions(&arguments, CommandLine::command()),
        Command::Manual(arguments) => shell::manual(&arguments, CommandLine::command()),
    };
    match ending {
        Ok(Ending::Done) => ExitCode::SUCCESS,
        Ok(Ending::AboveLimit) => ExitCode::from(5),
        // 128 + SIGINT, as shells have it.
        Ok(Ending::Stopped) => ExitCode::from(130),
        Err(error) => {
            say(format_args!("penumbra: error: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

/// Prints help and version as clap does, and wrong usage on one line, as every other error.
fn answer(error: &clap::Error) -> ExitCode {
    let help = error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
    if help || !error.use_stderr() {
        // Nobody reads output that cannot be written.
        let _ = error.print();
    } else {
        say(format_args!("penumbra: error: {}; try --help", one_line(&error.to_string())));
    }
    ExitCode::from(if error.use_stderr() { 2 } else { 0 })
}

/// A message of clap's without its paragraphs on usage and help, on one line.
fn one_line(message: &str) -> String {
    let paragraphs = message.trim_start_matches("error: ").split("\n\n");
    let problems = paragraphs.take_while(|text| !text.starts_with("Usage:") && !text.starts_with("For more"));
    let joined = problems.map(|text| text.split_whitespace().collect::<Vec<_>>().join(" "));
    // The integer parser's message for 1.5.
    joined.collect::<Vec<_>>().join("; ").replace("invalid digit found in string", "it must be a whole number")
}

/// Writes a line to stderr. As all output, it names flags where the library names settings.
fn say(line: impl Display) {
    // Nobody reads a closed stderr.
    let _ = writeln!(io::stderr(), "{}", with_flags(&line.to_string()));
}

/// Writes the result of a command to stdout. It is not an error if the reader stops reading (`| head`).
fn print(text: &str) -> Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(with_flags(text).as_bytes()).and_then(|()| stdout.flush()) {
        Err(problem) if problem.kind() != io::ErrorKind::BrokenPipe => Err(Error::output("stdout", problem)),
        _ => Ok(()),
    }
}

/// Writes a value to stdout as JSON.
fn print_json(value: &impl serde::Serialize) -> Result<()> {
    print(&(json(value).map_err(|problem| Error::output("stdout", problem))? + "\n"))
}

/// Writes a file. What the file held before stays until all of it is written.
fn write_text(path: &Path, text: &str) -> Result<()> {
    film::write_atomically(path, |file| Ok(file.write_all(text.as_bytes())?))
}

fn json(value: &impl serde::Serialize) -> serde_json::Result<String> {
    serde_json::to_string_pretty(value).map(|text| with_flags(&text).into_owned())
}
