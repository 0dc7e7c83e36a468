//! Secrets of 256 random bits, and what is kept of them: their SHA-256.

use crate::words::hexadecimal;
use sha2::{Digest, Sha256};
use std::io::Read;

/// What is kept of a secret: its SHA-256 in hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(transparent)]
pub(super) struct Hash(String);

impl Hash {
    /// The hash of a secret as it was given.
    pub(super) fn of(secret: &str) -> Self {
        Self(hexadecimal(&Sha256::digest(secret.as_bytes())))
    }

    /// A short name of it for people; it cannot be used for anything but ending the session.
    pub(super) fn name(&self) -> &str {
        self.0.get(..8).unwrap_or(&self.0)
    }
}

/// A new secret: 64 hexadecimal digits.
///
/// # Errors
/// If the system gives no random bytes.
pub(super) fn new_secret() -> std::io::Result<String> {
    let mut bytes = [0; 32];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(hexadecimal(&bytes))
}

/// The token that requests of a session carry beside its cookie. It follows from the session's secret, and that does
/// not follow from it.
pub(super) fn request_token(session: &str) -> String {
    let mut hash = Sha256::new();
    hash.update(b"scand page request\n");
    hash.update(session.as_bytes());
    hexadecimal(&hash.finalize())
}

/// Whether two texts are equal, in a time that depends on their lengths alone.
pub(super) fn are_equal(a: &str, b: &str) -> bool {
    let pairs = a.bytes().zip(b.bytes());
    a.len() == b.len() && pairs.fold(0, |different, (a, b)| different | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_differ_and_are_compared_whole() {
        let (a, b) = (new_secret().unwrap(), new_secret().unwrap());
        assert_eq!(a.len(), 64);
        assert_ne!(a, b);
        assert!(are_equal(&a, &a) && !are_equal(&a, &b) && !are_equal(&a, &a[..63]));
        assert_ne!(request_token(&a), request_token(&b));
        // SHA-256 of no bytes, which FIPS 180 fixes.
        assert!(Hash::of("").0.starts_with("e3b0c44298fc1c14"));
    }
}
