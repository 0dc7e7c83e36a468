//! How far a model can be trusted: the three words that a report's verdict, the daemon's events, its hooks and the
//! command line share.

use serde::{Deserialize, Serialize};

/// How far a model can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Nothing is wrong. A reason of this level is a note.
    Green,
    /// It can be used, but a person should look.
    Amber,
    /// It should not be used.
    Red,
}

impl Level {
    /// All of them, the best first.
    pub const ALL: [Self; 3] = [Self::Green, Self::Amber, Self::Red];

    /// Its word in JSON, in a hook's environment and on the console.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Green => "green",
            Self::Amber => "amber",
            Self::Red => "red",
        }
    }
}
