//! Commands to a sensor while it runs: a text file with one command in each line, after the sensor's serial number
//! or `*`. `capture N` plays the file's capture N; `silent` gives no frames; `gone` unplugs it; `damaged N` cuts
//! off each Nth frame; `frozen` makes its clock stand still; `unregistered` makes it forget registration;
//! `unsynchronised` makes it refuse to synchronise. What no line mentions is off.

use std::path::Path;

/// What is so now.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Control {
    pub capture: usize,
    pub silent: bool,
    pub gone: bool,
    /// Each so many frames one is cut off; 0 for none.
    pub damaged: u64,
    pub frozen: bool,
    pub unregistered: bool,
    pub unsynchronised: bool,
}

impl Control {
    /// Reads what holds for a sensor; a file that is not there says nothing.
    pub fn read(path: Option<&Path>, serial: &str) -> Self {
        let text = path.and_then(|p| std::fs::read_to_string(p).ok());
        Self::parse(&text.unwrap_or_default(), serial)
    }

    fn parse(text: &str, serial: &str) -> Self {
        let mut control = Self::default();
        for line in text.lines() {
            let mut words = line.split_whitespace();
            if words.next().is_none_or(|who| who != "*" && who != serial) {
                continue;
            }
            let what = words.next().unwrap_or_default();
            let number = words.next().and_then(|n| n.parse().ok()).unwrap_or(1);
            match what {
                "capture" => control.capture = number as usize,
                "silent" => control.silent = true,
                "gone" => control.gone = true,
                "damaged" => control.damaged = number,
                "frozen" => control.frozen = true,
                "unregistered" => control.unregistered = true,
                "unsynchronised" => control.unsynchronised = true,
                _ => {}
            }
        }
        control
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_sensor_hears_what_it_is_told() {
        let text = "d0 capture 3\nd1 silent\n* damaged 5\n\nd0\nnonsense frozen\n";
        let d0 = Control::parse(text, "d0");
        assert_eq!((d0.capture, d0.damaged, d0.silent), (3, 5, false));
        let d1 = Control::parse(text, "d1");
        assert!(d1.silent && !d1.frozen && d1.damaged == 5);
    }
}
