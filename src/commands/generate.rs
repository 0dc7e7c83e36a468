//! `scand generate`: completions for shells and man pages, from the definition of the command line. For packagers.

use super::{Cli, write_out};
use anyhow::Context;
use clap::CommandFactory;
use clap_complete::Shell;
use std::path::PathBuf;
use std::process::ExitCode;

/// Write completions for a shell, or man pages
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: Artifact,
}

#[derive(Debug, clap::Subcommand)]
enum Artifact {
    /// Print the completions for a shell
    Completions {
        /// The shell
        shell: Shell,
    },
    /// Write a man page for each command
    Man {
        /// The folder that gets the pages
        folder: PathBuf,
    },
}

/// Prints or writes what is asked for.
///
/// # Errors
/// If a man page cannot be written.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.what {
        Artifact::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "scand", &mut text);
            write_out(&String::from_utf8_lossy(&text));
        }
        Artifact::Man { folder } => {
            std::fs::create_dir_all(&folder)
                .and_then(|()| clap_mangen::generate_to(Cli::command(), &folder))
                .with_context(|| folder.display().to_string())?;
        }
    }
    Ok(ExitCode::SUCCESS)
}
