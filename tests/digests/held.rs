//! Compares digests of what the program writes with `tests/digests.toml`. `tests/digests.rs` uses it, and so do the
//! library's own tests of output that only they can reach. Nothing here knows what is digested.

use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::Path;

/// SHA-256 in hexadecimal digits.
pub(crate) fn sha256(bytes: &[u8]) -> String {
    format!("{:x}", Sha256::digest(bytes))
}

/// Digests the messages of a recording: topic, log time, publish time and payload, in the order of log times. Topics of
/// one log time follow each other by name, because cameras that are read side by side hand frames over in any order.
/// Left out are `/log`, schemas, and the name of the program that wrote it.
pub(crate) fn messages(recording: &Path) -> String {
    let bytes = std::fs::read(recording).unwrap();
    let stream = mcap::MessageStream::new(&bytes).unwrap();
    let mut all: Vec<mcap::Message> = stream.map(Result::unwrap).collect();
    all.retain(|message| message.channel.topic != "/log");
    all.sort_by(|a, b| (a.log_time, &a.channel.topic).cmp(&(b.log_time, &b.channel.topic)));
    let mut digested = Vec::new();
    for message in &all {
        let mut add = |part: &[u8]| {
            digested.extend((part.len() as u64).to_le_bytes());
            digested.extend(part);
        };
        add(message.channel.topic.as_bytes());
        add(&message.log_time.to_le_bytes());
        add(&message.publish_time.to_le_bytes());
        add(&message.data);
    }
    sha256(&digested)
}

/// Compares digests with those of the same names in the file. With `SCAND_WRITE_DIGESTS=1` they are entered there
/// instead: a change of what is written needs a reason, which the commit states.
pub(crate) fn hold(found: &BTreeMap<String, String>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/digests.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let mut expected: BTreeMap<String, String> = toml::from_str(&text).unwrap();
    if std::env::var_os("SCAND_WRITE_DIGESTS").is_some() {
        expected.extend(found.clone());
        let comments = text.lines().take_while(|line| line.starts_with('#'));
        let comments: String = comments.map(|line| format!("{line}\n")).collect();
        let table = toml::to_string(&expected).unwrap();
        return std::fs::write(&path, format!("{comments}\n{table}")).unwrap();
    }
    for (name, digest) in found {
        assert_eq!(
            expected.get(name),
            Some(digest),
            "{name} is not what it was; if that is intended, run this test with SCAND_WRITE_DIGESTS=1 and give the \
             reason in the commit"
        );
    }
}
