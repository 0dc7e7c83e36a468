//! `scand generate`: completions for shells and man pages, from the definition of the command line. For packagers.

use super::{Cli, write_out};
use crate::storage::write_atomically;
use clap::{Command, CommandFactory};
use clap_complete::Shell;
use clap_mangen::Man;
use std::path::{Path, PathBuf};
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
            let mut command = Cli::command().disable_help_subcommand(true);
            command.build();
            write_pages(command, &folder)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the page of a command and those of its subcommands.
fn write_pages(command: Command, folder: &Path) -> anyhow::Result<()> {
    let shown = command.get_subcommands().filter(|c| !c.is_hide_set());
    for subcommand in shown.cloned() {
        write_pages(subcommand, folder)?;
    }
    let page = Man::new(command);
    let mut text = Vec::new();
    page.render(&mut text)?;
    Ok(write_atomically(&folder.join(page.get_filename()), &text)?)
}
