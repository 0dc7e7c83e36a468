//! Makes the name of an object's folder from its subject: any text becomes one name that every file system accepts.

use sha2::{Digest, Sha256};
use std::fmt::Write;

/// The ending of an object's folder.
pub(super) const ENDING: &str = ".object";
/// Bytes of the longest name.
const LONGEST: usize = 200;
/// Bytes of the digest in a name that was shortened, so that two such are not the same.
const DIGEST_BYTES: usize = 8;

/// The name of an object's folder: bytes other than `A-Z a-z 0-9 . _ -`, and a dot at the begin, as %XX. What is longer
/// than 200 bytes is cut, and ends with a digest of the whole.
pub fn object_folder_name(subject: &str) -> String {
    let mut name = String::new();
    for (i, byte) in subject.bytes().enumerate() {
        let is_plain = byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
        if is_plain && !(i == 0 && byte == b'.') {
            name.push(byte.into());
        } else {
            let _ = write!(name, "%{byte:02X}");
        }
    }
    let room = LONGEST - ENDING.len();
    if name.len() > room {
        let digest = format!("{:x}", Sha256::digest(subject));
        let digest = &digest[..2 * DIGEST_BYTES];
        name.truncate(room - digest.len() - 1);
        name = format!("{name}-{digest}");
    }
    name + ENDING
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subject_is_one_name_and_no_path() {
        assert_eq!(object_folder_name("17"), "17.object");
        assert_eq!(object_folder_name("1884.3_a-B"), "1884.3_a-B.object");
        assert_eq!(object_folder_name("../x"), "%2E.%2Fx.object");
        assert_eq!(object_folder_name(".hidden"), "%2Ehidden.object");
        assert_eq!(object_folder_name("ä 1"), "%C3%A4%201.object");
        let (a, b) = ("x".repeat(4096), "x".repeat(4095));
        assert_eq!(object_folder_name(&a).len(), 200);
        assert_ne!(object_folder_name(&a), object_folder_name(&b));
    }
}
