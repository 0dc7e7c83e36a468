//! Runs what a new user types: `scand demo`, and the lines of README.md and docs/commands.md that can be pasted in
//! order.

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::super::desk::said;
    use std::path::Path;
    use std::process::Output;

    /// Runs the program in a folder.
    fn scand(folder: &Path, arguments: &str) -> Output {
        let mut command = assert_cmd::Command::cargo_bin("scand").unwrap();
        let command = command.current_dir(folder);
        command.args(arguments.split(' ')).output().unwrap()
    }

    #[test]
    fn the_demo_makes_a_model_and_says_where_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let output = scand(folder.path(), "demo");
        let words = said(&output);
        assert!(output.status.success(), "{words}");
        // The verdict comes with its reasons and notes.
        assert!(words.contains("cup-000: green"), "{words}");
        assert!(words.contains("is interpolated"), "{words}");
        let model = "demo/models/cup/cup-000";
        for name in ["preview.png", "model.glb"] {
            let path = format!("{model}/{name}");
            assert!(words.contains(&path), "{words}");
            assert!(folder.path().join(path).is_file());
        }
        // A second run finds all of it, and a file of another content is not replaced.
        let again = scand(folder.path(), "demo");
        assert!(said(&again).contains("unchanged since it was made"));
        std::fs::write(folder.path().join("demo/cup.mcap"), "another").unwrap();
        let refused = scand(folder.path(), "demo");
        let words = said(&refused);
        assert_eq!(refused.status.code(), Some(1), "{words}");
        assert!(words.contains("give another folder with --out"), "{words}");
        let left = std::fs::read(folder.path().join("demo/cup.mcap")).unwrap();
        assert_eq!(left, b"another");
    }

    /// The commands of a page's indented lines.
    fn lines<'a>(page: &'a str, prefix: &str) -> Vec<&'a str> {
        let indented = page.lines().filter_map(|line| line.strip_prefix("    "));
        indented
            .filter_map(|line| line.strip_prefix(prefix))
            .collect()
    }

    #[test]
    fn the_lines_of_the_readme_and_of_the_commands_can_be_pasted_in_order() {
        let readme = lines(include_str!("../../README.md"), "cargo run --release -- ");
        let commands = lines(include_str!("../../docs/commands.md"), "scand ");
        assert!(
            readme.len() >= 3 && commands.len() >= 9,
            "{readme:?} {commands:?}"
        );
        for page in [readme, commands] {
            let folder = tempfile::tempdir().unwrap();
            let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings");
            std::os::unix::fs::symlink(recordings, folder.path().join("recordings")).unwrap();
            for line in page {
                let output = scand(folder.path(), line);
                assert!(output.status.success(), "scand {line}: {}", said(&output));
            }
        }
    }
}
