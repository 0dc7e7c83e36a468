//! Tests of the help and of the definition of the command line.

use clap::CommandFactory;

/// Each command that is not hidden stands in the help, in one of its groups, and nothing else does.
#[test]
fn the_help_has_every_command_in_a_group() {
    let lines = super::HELP
        .lines()
        .filter_map(|line| line.strip_prefix("  "));
    let commands = lines.filter(|line| line.starts_with(|c: char| c.is_ascii_lowercase()));
    let shown: Vec<&str> = commands
        .filter(|line| !line.starts_with("scand "))
        .collect();
    let shown: Vec<&str> = shown
        .iter()
        .filter_map(|line| line.split(' ').next())
        .collect();
    let cli = super::Cli::command();
    let known: Vec<&str> = cli.get_subcommands().map(clap::Command::get_name).collect();
    for name in &shown {
        assert!(known.contains(name), "{name}");
    }
    for command in cli
        .get_subcommands()
        .filter(|command| !command.is_hide_set())
    {
        assert!(
            shown.contains(&command.get_name()),
            "{}",
            command.get_name()
        );
    }
}

/// Whether a command can only say that this build has not got it.
fn is_absent(command: &clap::Command) -> bool {
    command.is_hide_set() || command.is_disable_help_flag_set()
}

#[test]
fn every_command_has_examples_and_the_same_short_flags() {
    let short = [
        ("out", 'o'),
        ("force", 'f'),
        ("quiet", 'q'),
        ("config", 'c'),
        ("jobs", 'j'),
    ];
    let cli = super::Cli::command();
    for command in cli.get_subcommands().filter(|command| !is_absent(command)) {
        let name = command.get_name();
        let examples = command
            .get_after_help()
            .map(ToString::to_string)
            .unwrap_or_default();
        assert!(examples.contains("Example"), "{name}");
        assert!(
            examples.contains(&format!("scand {name}")),
            "{name}: {examples}"
        );
        for argument in command.get_arguments() {
            let known = short
                .iter()
                .find(|(long, _)| argument.get_long() == Some(*long));
            if let Some((long, letter)) = known {
                assert_eq!(argument.get_short(), Some(*letter), "{name} --{long}");
            }
        }
    }
}

/// The words of a line as a shell splits them, as far as examples need it.
fn shell_words(line: &str) -> Vec<String> {
    let parts = line.split('"').enumerate();
    parts
        .flat_map(|(number, part)| match number % 2 {
            0 => part.split_whitespace().map(str::to_owned).collect(),
            _ => vec![part.to_owned()],
        })
        .collect()
}

#[test]
fn every_example_is_a_command_line_that_scand_takes() {
    let cli = super::Cli::command();
    let helps = cli.get_subcommands().filter(|command| !is_absent(command));
    let helps = helps.filter_map(|command| Some(command.get_after_help()?.to_string()));
    let all: Vec<String> = helps.chain([super::HELP.to_owned()]).collect();
    let mut tried = 0;
    for line in all.iter().flat_map(|help| help.lines()) {
        let line = line.trim().trim_start_matches("sudo ");
        if line.starts_with("scand ") && !line.contains("COMMAND") {
            let parsed = super::Cli::command().try_get_matches_from(shell_words(line));
            assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
            tried += 1;
        }
    }
    assert!(tried > 40, "{tried}");
}

#[test]
fn the_command_line_is_sound() {
    super::Cli::command().debug_assert();
}

/// Checks the options of a command and of those below it.
fn check_lengths(command: &clap::Command, seen: &mut usize) {
    for argument in command.get_arguments() {
        let name = argument.get_long().unwrap_or_default();
        if !name.ends_with("-mm") {
            continue;
        }
        *seen += 1;
        let help = argument.get_long_help().or(argument.get_help());
        let help = help.map(ToString::to_string).unwrap_or_default();
        let help = help.to_lowercase();
        let tells = help.contains("plain number") && help.contains("millimetres");
        assert!(tells, "{} --{name}: {help}", command.get_name());
    }
    for command in command.get_subcommands() {
        check_lengths(command, seen);
    }
}

#[test]
fn options_in_millimetres_say_what_a_plain_number_counts() {
    let mut seen = 0;
    check_lengths(&super::Cli::command(), &mut seen);
    assert!(seen >= 2, "{seen}");
}
