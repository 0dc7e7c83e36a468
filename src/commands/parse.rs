//! Reads the command line, and adds a suggestion to clap's errors.

use super::Cli;
use crate::words::shell_word;
use clap::error::{ContextKind, ContextValue, Error, ErrorKind};
use clap::{CommandFactory, Parser};
use std::ffi::OsString;
use std::path::Path;

/// Reads the command line. Ends the process where it asks for help or cannot be read.
pub fn parse() -> Cli {
    let arguments = asked_for_help(std::env::args_os().collect());
    Cli::try_parse_from(&arguments).unwrap_or_else(|mut error| {
        let tip = tip(&error);
        if tip.is_some() {
            // What merely looks alike would mislead beside it.
            error.remove(ContextKind::SuggestedSubcommand);
            error.remove(ContextKind::Suggested);
        }
        print(&error);
        if let Some(tip) = tip {
            eprintln!("\n  tip: {tip}");
        }
        std::process::exit(error.exit_code())
    })
}

fn print(error: &Error) {
    let rendered = error.render().to_string();
    let plain = in_plain_words(&rendered);
    if error.kind() == ErrorKind::ValueValidation && plain != rendered {
        eprint!("{plain}");
    } else {
        let _ = error.print();
    }
}

/// A message about a number as a person would say it, and not as Rust's parsers do.
fn in_plain_words(text: &str) -> String {
    let text = text
        .replace("invalid digit found in string", "expected a whole number")
        .replace(
            "cannot parse integer from empty string",
            "expected a whole number",
        )
        .replace(
            "number too large to fit in target type",
            "the number is too large",
        )
        .replace("invalid float literal", "expected a number");
    let range = text.split_once(" is not in ").and_then(|(before, after)| {
        let (least, after) = after.split_once("..")?;
        let is_number = least.parse::<i64>().is_ok();
        is_number.then(|| match after.strip_prefix('=') {
            Some(most) => format!("{before}, expected {least} to {most}"),
            None => format!("{before}, expected {least} or more{after}"),
        })
    });
    range.unwrap_or(text)
}

/// `scand help COMMAND` of a command that this build does not have is that command, which says where it is.
fn asked_for_help(mut arguments: Vec<OsString>) -> Vec<OsString> {
    let asked = |at: usize| arguments.get(at).and_then(|word| word.to_str());
    let is_absent = |name: &str| {
        let command = Cli::command();
        let found = command.find_subcommand(name);
        found.is_some_and(|command| command.is_disable_help_flag_set())
    };
    if asked(1) == Some("help") && asked(2).is_some_and(is_absent) {
        arguments.remove(1);
    }
    arguments
}

/// What a person should know about an error besides its text.
fn tip(error: &Error) -> Option<String> {
    let said = |kind: ContextKind| match error.get(kind) {
        Some(ContextValue::String(word)) => Some(word.as_str()),
        _ => None,
    };
    match error.kind() {
        ErrorKind::InvalidSubcommand => tip_of_command(said(ContextKind::InvalidSubcommand)?),
        ErrorKind::UnknownArgument => tip_of_option(said(ContextKind::InvalidArg)?),
        _ => None,
    }
}

/// Of an option that another build has.
fn tip_of_option(word: &str) -> Option<String> {
    let of_fleet = ["--fleet", "--credentials", "--authority", "--in-flight"];
    (!cfg!(feature = "fleet") && of_fleet.contains(&word)).then(|| {
        "this build of scand makes models on this machine alone: the Debian package that `make deb` makes and builds \
         with `--features fleet` have workers"
            .into()
    })
}

/// Of a word that is no command.
fn tip_of_command(word: &str) -> Option<String> {
    let is_recording = [".mcap", ".part"]
        .iter()
        .any(|ending| word.ends_with(ending));
    if is_recording || Path::new(word).exists() {
        let file = shell_word(Path::new(word));
        return Some(format!("to reconstruct a recording: scand replay {file}"));
    }
    let known = match word {
        "version" => "scand --version",
        "convert" | "save" => "scand export MODEL --format obj|stl|3mf|usdz|glb",
        "export-ros" => "scand calibrate --from FILE --ros DIR",
        "colmap" | "dataset" => "scand export RECORDING --dataset colmap|nerfstudio|openmvs",
        "reconstruct" | "model" | "scan" => "scand replay FILE, or scand trigger at a rig",
        "start" | "daemon" | "serve" => "scand run --config FILE, or systemctl start scand",
        "capture" | "press" | "shoot" => "scand trigger",
        "accept" | "reject" | "clear" => "scand note CAPTURE accept|reject|clear",
        "repair" | "fix" => "scand recover FILE",
        "bag" | "bagit" | "package" => "scand archive NAME --out DIR",
        "validate" => "scand verify DIR",
        "list" | "ls" | "show" | "inspect" => "scand info FILE",
        "compare" => "scand diff A B",
        "measure" => "scand evaluate MODEL TRUTH",
        "compress" => "scand pack FILE",
        "merge" => "scand fuse FILE --subject NUMBER",
        "view" | "open" => "scand publish MODEL --out DIR, or any viewer of glTF files",
        "completions" | "completion" => "scand generate completions SHELL",
        "man" | "manual" => "scand generate man DIR",
        _ => return None,
    };
    Some(format!("you may want: {known}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<OsString> {
        line.split(' ').map(Into::into).collect()
    }

    #[test]
    fn numbers_are_asked_for_in_words() {
        for (rust, words) in [
            (
                "'--jobs <N>': 0 is not in 1..=64\n",
                "'--jobs <N>': 0, expected 1 to 64\n",
            ),
            (
                "'-n <N>': 0 is not in 1..\n",
                "'-n <N>': 0, expected 1 or more\n",
            ),
            (
                "'-n <N>': invalid digit found in string",
                "'-n <N>': expected a whole number",
            ),
            ("c77 is not in the list..", "c77 is not in the list.."),
        ] {
            assert_eq!(in_plain_words(rust), words);
        }
    }

    #[test]
    fn help_on_a_command_that_is_not_here_says_where_it_is() {
        let asked = asked_for_help(words("scand help page"));
        match cfg!(feature = "page") {
            true => assert_eq!(asked, words("scand help page")),
            false => assert_eq!(asked, words("scand page")),
        }
        for line in ["scand help replay", "scand help", "scand replay help page"] {
            assert_eq!(asked_for_help(words(line)), words(line));
        }
    }
}
