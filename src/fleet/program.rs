//! Which program makes a model: version, commit and processor architecture. Two programs of the same name make the same
//! bytes, so a build of sources that are in no commit has no name, and takes and gives no jobs.

use std::fmt;

/// The name of a program that takes part in a fleet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    version: String,
    commit: String,
}

/// Why this program takes no part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProgramError {
    /// It is not known what it was built from.
    #[error(
        "this program was built outside of a git checkout, so that its commit is unknown: other machines cannot have the \
         same one, so it cannot join a fleet; build it in a git checkout"
    )]
    Unknown,
    /// It was built from sources that no commit has.
    #[error(
        "this program was built from changes that are not committed: other machines cannot have the same one, so it \
         cannot join a fleet; commit the changes and build it again"
    )]
    Uncommitted,
}

/// In a build for tests alone: plays the part of the commit, which is then called `test-NAME`.
#[cfg(debug_assertions)]
const TEST_NAME: &str = "SCAND_FLEET_TEST_PROGRAM";

impl Program {
    /// This one.
    ///
    /// # Errors
    /// If no other machine can have the same one.
    pub fn current() -> Result<Self, ProgramError> {
        #[cfg(debug_assertions)]
        if let Ok(name) = std::env::var(TEST_NAME) {
            return Self::of(&format!("test-{name}"));
        }
        Self::of(env!("SCAND_SOURCES"))
    }

    pub(super) fn of(commit: &str) -> Result<Self, ProgramError> {
        match commit {
            "unknown" => Err(ProgramError::Unknown),
            "uncommitted" => Err(ProgramError::Uncommitted),
            commit => Ok(Self {
                version: env!("CARGO_PKG_VERSION").into(),
                commit: commit.into(),
            }),
        }
    }

    /// Its name as a part of a subject, in which dots would separate.
    pub(super) fn token(&self) -> String {
        self.to_string().replace('.', "_")
    }
}

impl fmt::Display for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { version, commit } = self;
        write!(f, "{version}-{commit}-{}", std::env::consts::ARCH)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_commit_makes_a_program_that_others_can_have() {
        assert_eq!(Program::of("unknown"), Err(ProgramError::Unknown));
        assert_eq!(Program::of("uncommitted"), Err(ProgramError::Uncommitted));
        let program = Program::of("0123456789ab").unwrap();
        let arch = std::env::consts::ARCH;
        let version = env!("CARGO_PKG_VERSION");
        assert_eq!(
            program.to_string(),
            format!("{version}-0123456789ab-{arch}")
        );
        assert!(!program.token().contains('.'), "{}", program.token());
    }
}
