//! Commands to a sensor while it runs: a text file with one command in each line, after the sensor's serial number
//! or `*`. `capture N` plays the file's capture N; `silent` gives no frames; `gone` unplugs it; `damaged N` cuts
//! off each Nth frame; `frozen` makes its clock stand still; `unregistered` makes it forget registration;
//! `unsynchronised` makes it refuse to synchronise. What no line mentions is off. A sensor that does what the file says
//! writes the file's text into `FILE.heard-SERIAL`, which is there as long as the sensor plays.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

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

/// A sensor's way to the file of commands, and back.
pub struct Channel {
    file: Option<PathBuf>,
    serial: String,
    /// The text that was acknowledged last.
    heard: Mutex<Option<String>>,
}

impl Channel {
    pub fn new(file: Option<PathBuf>, serial: &str) -> Self {
        Self {
            file,
            serial: serial.to_owned(),
            heard: Mutex::default(),
        }
    }

    /// What holds for the sensor, and the whole text that says so; a file that is not there says nothing.
    pub fn read(&self) -> (Control, String) {
        let text = self
            .file
            .as_ref()
            .and_then(|file| std::fs::read_to_string(file).ok());
        let text = text.unwrap_or_default();
        (Control::parse(&text, &self.serial), text)
    }

    /// Tells that the sensor does what a text says.
    pub fn acknowledge(&self, text: String) {
        let mut heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        if heard.as_ref() == Some(&text) {
            return;
        }
        let (Some(answer), Some(written)) = (self.beside("heard"), self.beside("part")) else {
            return;
        };
        let put = std::fs::write(&written, &text).and_then(|()| std::fs::rename(&written, answer));
        match put {
            Ok(()) => *heard = Some(text),
            Err(why) => eprintln!("test sensor: {}: {why}", written.display()),
        }
    }

    /// Tells that the sensor does not play any more.
    pub fn close(&self) {
        if let Some(answer) = self.beside("heard") {
            let _ = std::fs::remove_file(answer);
        }
    }

    fn beside(&self, what: &str) -> Option<PathBuf> {
        let file = self.file.as_ref()?;
        Some(file.with_extension(format!("{what}-{}", self.serial)))
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
