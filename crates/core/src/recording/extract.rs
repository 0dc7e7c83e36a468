//! Copies chosen messages of a recording into a recording of its own, as they are, and computes the digest of what it
//! holds. What is chosen, and why, is not known here.

use super::{Compression, Error, MessageRef, Recording, Topic, Writer};
use crate::frame::Timestamp;
use crate::words::hexadecimal;
use sha2::{Digest, Sha256};
use std::path::Path;

/// Metadata that each writer adds itself.
const OF_THE_WRITER: &str = "scand";

impl Recording {
    /// Writes the messages that are `chosen`, and all metadata, into a packed recording at `to`. Attachments stay
    /// behind. Returns what [`Self::content_sha256`] says of the new recording.
    ///
    /// # Errors
    /// If a message cannot be read, or the new recording cannot be written or does not hold the same.
    pub fn extract(
        &self,
        chosen: &[(Topic, MessageRef)],
        to: &Path,
        program: &str,
    ) -> Result<String, Error> {
        let mut writer = Writer::create(to, program, Compression::ZstdFastest)?;
        let mut content = Content::default();
        for (name, pairs) in self.metadata().iter().filter(|(n, _)| n != OF_THE_WRITER) {
            writer.metadata(name, pairs)?;
            content.add(&[name.as_bytes(), format!("{pairs:?}").as_bytes()]);
        }
        for (topic, message) in chosen {
            let (data, schema) = self.read(topic, message)?;
            content.message(topic, schema, message.log_time(), &data);
            writer.copy(
                topic,
                self.schema_record(message),
                &data,
                message.log_time(),
            )?;
        }
        writer.finish()?;
        Ok(content.finish())
    }

    /// SHA-256 over the metadata and every message on a topic of the format, in the order of topics and times, however
    /// the file is packed.
    ///
    /// # Errors
    /// If a message cannot be read.
    pub fn content_sha256(&self) -> Result<String, Error> {
        let mut content = Content::default();
        for (name, pairs) in self.metadata().iter().filter(|(n, _)| n != OF_THE_WRITER) {
            content.add(&[name.as_bytes(), format!("{pairs:?}").as_bytes()]);
        }
        for topic in self.topics() {
            for message in self.messages(topic) {
                let (data, schema) = self.read(topic, message)?;
                content.message(topic, schema, message.log_time(), &data);
            }
        }
        Ok(content.finish())
    }
}

/// What a recording holds, as a digest in the making.
#[derive(Default)]
struct Content(Sha256);

impl Content {
    fn add(&mut self, parts: &[&[u8]]) {
        for part in parts {
            self.0.update((part.len() as u64).to_le_bytes());
            self.0.update(part);
        }
    }

    fn message(&mut self, topic: &Topic, schema: &str, time: Timestamp, data: &[u8]) {
        let topic = topic.to_string();
        let time = time.0.to_le_bytes();
        self.add(&[topic.as_bytes(), schema.as_bytes(), &time, data]);
    }

    fn finish(self) -> String {
        hexadecimal(&self.0.finalize())
    }
}
