//! The program `penumbra`.

mod cli;

fn main() -> std::process::ExitCode {
    cli::run()
}
