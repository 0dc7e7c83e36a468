//! A folder in which a person works with the command line: a small recording lies in it, and commands run there.

use assert_cmd::Command;
use scand::recording::Recording;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Output;

pub struct Desk(tempfile::TempDir);

impl Desk {
    /// A folder with `ball.mcap`, a recording of two captures.
    pub fn new() -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        #[rustfmt::skip]
        desk.done(&[
            "simulate", "--shape", "ball", "--cameras", "5", "--size", "160x120", "--masks", "--depth-cameras", "0",
            "--captures", "2", "--out", "ball.mcap",
        ]);
        desk
    }

    /// A desk with the model of its recording's first capture.
    pub fn with_a_model() -> Self {
        let desk = Self::new();
        #[rustfmt::skip]
        desk.done(&["replay", "ball.mcap", "--capture", "ball-000", "--set", "hull.resolution=40", "-q"]);
        desk
    }

    /// Adds pairs to a recording's session, as `scand session start NAME --about KEY=VALUE` does before captures.
    pub fn tell(&self, recording: &str, pairs: &[(&str, &str)]) {
        let owned = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
        let session = ("session".into(), pairs.iter().map(owned).collect());
        self.rewrite(recording, vec![session], |_| {});
    }

    /// Gives a capture of a recording another id.
    pub fn rename_capture(&self, recording: &str, from: &str, to: &str) {
        self.rewrite(recording, Vec::new(), |message| {
            if matches!(message.channel.topic.as_str(), "/trigger" | "/capture") {
                let text = String::from_utf8_lossy(&message.data).replace(from, to);
                message.data = text.into_bytes().into();
            }
        });
    }

    /// Writes a recording anew, with more records of metadata and with changed messages.
    fn rewrite(
        &self,
        recording: &str,
        more: Vec<(String, BTreeMap<String, String>)>,
        change: impl Fn(&mut mcap::Message<'_>),
    ) {
        let path = self.path(recording);
        let bytes = std::fs::read(&path).unwrap();
        let mut records = Recording::open(&path).unwrap().metadata().to_vec();
        records.extend(more);
        let options = mcap::WriteOptions::new().compression(None).profile("scand");
        let mut writer = options.create(File::create(&path).unwrap()).unwrap();
        for (name, metadata) in records {
            writer
                .write_metadata(&mcap::records::Metadata { name, metadata })
                .unwrap();
        }
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let mut message = message.unwrap();
            change(&mut message);
            writer.write(&message).unwrap();
        }
        writer.finish().unwrap();
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::cargo_bin("scand").unwrap();
        command
            .current_dir(self.0.path())
            .args(arguments)
            .output()
            .unwrap()
    }

    /// Runs a command that must succeed; gives what it says.
    pub fn done(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments:?}: {output:?}");
        said(&output)
    }
}

/// What a command printed, on standard output and on standard error.
pub fn said(output: &Output) -> String {
    [&output.stdout, &output.stderr]
        .map(|bytes| String::from_utf8_lossy(bytes))
        .concat()
}

/// All files below a folder, by their paths in it.
pub fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().to_str().unwrap();
                found.insert(name.to_owned(), std::fs::read(&path).unwrap());
            }
        }
    }
    found
}
