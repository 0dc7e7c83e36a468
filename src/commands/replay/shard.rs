//! Splits captures between several runs of a replay that cannot talk to each other, such as the jobs of a batch system.

use crate::frame::{CaptureId, Timestamp};
use sha2::{Digest, Sha256};
use std::fmt;
use std::str::FromStr;

/// One of several parts of all captures: `2/8` is the second of eight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shard {
    /// From 1.
    number: u64,
    of: u64,
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("{text:?} is not I/N with I from 1 to N, such as 2/8");
        let (number, of) = text.split_once('/').ok_or_else(bad)?;
        let number: u64 = number.parse().map_err(|_| bad())?;
        let of: u64 = of.parse().map_err(|_| bad())?;
        if (1..=of).contains(&number) {
            Ok(Self { number, of })
        } else {
            Err(bad())
        }
    }
}

impl Shard {
    /// Whether a capture is in this part. Its id and the time of its trigger decide, so that it stays in its part under
    /// whatever name its recording is found.
    pub(super) fn has_capture(self, id: &CaptureId, time: Timestamp) -> bool {
        self.has(&format!("capture {id} {}", time.0))
    }

    /// Whether a recording that cannot be read is reported by this part: by one, rather than by all.
    pub(super) fn has_recording(self, stem: &str) -> bool {
        self.has(&format!("recording {stem}"))
    }

    fn has(self, identity: &str) -> bool {
        let hash = Sha256::digest(identity);
        let first = hash
            .iter()
            .take(8)
            .fold(0u64, |sum, byte| sum << 8 | u64::from(*byte));
        first % self.of == self.number - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_capture_is_in_one_part_and_always_in_the_same() {
        let parts: Vec<Shard> = (1..=4).map(|i| format!("{i}/4").parse().unwrap()).collect();
        let mut sizes = [0; 4];
        for i in 0..1000u64 {
            let id = CaptureId::new(&format!("cup-{i:03}")).unwrap();
            let within = |part: &&Shard| part.has_capture(&id, Timestamp(i));
            let found: Vec<&Shard> = parts.iter().filter(within).collect();
            assert_eq!(found.len(), 1, "{id}");
            sizes[found[0].number as usize - 1] += 1;
        }
        assert!(sizes.iter().all(|n| (200..300).contains(n)), "{sizes:?}");
        // What another version or another machine must not see differently.
        let id = CaptureId::new("cup-000").unwrap();
        let first = parts
            .iter()
            .position(|part| part.has_capture(&id, Timestamp(0)));
        assert_eq!(first, Some(PLACE_OF_CUP_000));
    }

    const PLACE_OF_CUP_000: usize = 3;

    #[test]
    fn what_is_no_part_is_refused() {
        for text in [
            "", "1", "0/4", "5/4", "-1/4", "1/0", "a/b", "1/4/2", "1 / 4",
        ] {
            let problem = text.parse::<Shard>().unwrap_err();
            assert!(problem.contains("I from 1 to N"), "{problem}");
        }
    }
}
