//! A small intact recording of the simulated rig, taken apart into its messages so that tests can damage them, and
//! put together again.

use mcap::records::MessageHeader;
use scand::recording::Compression;
use scand_lab::{DepthSensor, Options, Shape, Simulation, write};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::OnceLock;

/// One message with its channel.
#[derive(Clone)]
pub struct Message {
    pub topic: String,
    pub schema: String,
    pub schema_data: Vec<u8>,
    /// `protobuf` or `json`.
    pub encoding: String,
    pub log_time: u64,
    pub data: Vec<u8>,
}

/// The messages of a recording.
#[derive(Clone)]
pub struct Messages(pub Vec<Message>);

/// A bowl of two captures, `bowl-000` and `bowl-001`, seen by four colour cameras (`c00` to `c03`) and a depth
/// camera.
pub fn bowl() -> Messages {
    static BOWL: OnceLock<Vec<u8>> = OnceLock::new();
    Messages::read(BOWL.get_or_init(|| {
        let small = Options::small(Shape::Bowl);
        simulated(Options {
            cameras: 4,
            captures: 2,
            depth: DepthSensor {
                color_every: 10,
                color_jpeg_quality: 80,
                ..small.depth.clone()
            },
            ..small
        })
    }))
}

fn simulated(options: Options) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("simulated.mcap");
    let simulation = Simulation::new(options).unwrap();
    write(&simulation, &path, Compression::Zstd).unwrap();
    std::fs::read(&path).unwrap()
}

/// A ball with masks seen by three small cameras: a model of it takes no time.
pub fn ball() -> Messages {
    static BALL: OnceLock<Vec<u8>> = OnceLock::new();
    Messages::read(BALL.get_or_init(|| masked_ball(160, 120)))
}

/// The same with pictures fine enough for a hull of many cells.
pub fn fine_ball() -> Messages {
    Messages::read(&masked_ball(960, 720))
}

fn masked_ball(width: usize, height: usize) -> Vec<u8> {
    simulated(Options {
        cameras: 3,
        depth_cameras: 0,
        masks: true,
        width,
        height,
        ..Options::small(Shape::Ball)
    })
}

/// [`bowl`] with its first capture alone.
pub fn one_bowl() -> Messages {
    let mut messages = bowl();
    let second = messages.time_of("/trigger", 1);
    messages.0.retain(|m| m.log_time < second);
    messages
}

impl Messages {
    pub fn read(bytes: &[u8]) -> Self {
        let message = |m: mcap::Message| {
            let schema = m.channel.schema.as_ref().unwrap();
            Message {
                topic: m.channel.topic.clone(),
                schema: schema.name.clone(),
                schema_data: schema.data.to_vec(),
                encoding: m.channel.message_encoding.clone(),
                log_time: m.log_time,
                data: m.data.to_vec(),
            }
        };
        let stream = mcap::MessageStream::new(bytes).unwrap();
        Self(stream.map(|m| message(m.unwrap())).collect())
    }

    /// The depth camera's id.
    pub fn depth_camera(&self) -> String {
        let of_depth =
            |m: &Message| Some(m.topic.strip_prefix("/depth/")?.split('/').next()?.into());
        self.0.iter().find_map(of_depth).unwrap()
    }

    pub fn time_of(&self, topic: &str, index: usize) -> u64 {
        self.of(topic).nth(index).unwrap().log_time
    }

    pub fn of<'a>(&'a self, topic: &'a str) -> impl Iterator<Item = &'a Message> {
        self.0.iter().filter(move |m| m.topic == topic)
    }

    pub fn of_mut<'a>(&'a mut self, topic: &'a str) -> impl Iterator<Item = &'a mut Message> {
        self.0.iter_mut().filter(move |m| m.topic == topic)
    }

    /// Drops all messages of the topics that begin so.
    pub fn without(mut self, topics: &str) -> Self {
        self.0.retain(|m| !m.topic.starts_with(topics));
        self
    }

    /// Changes every message of a topic.
    pub fn with<M: prost::Message + Default>(
        mut self,
        topic: &str,
        change: impl Fn(&mut M),
    ) -> Self {
        let mut changed = 0;
        for message in self.of_mut(topic) {
            let mut content = M::decode(&message.data[..]).unwrap();
            change(&mut content);
            message.data = content.encode_to_vec();
            changed += 1;
        }
        assert!(changed > 0, "{topic} has no message");
        self
    }

    /// Changes every JSON message of a topic.
    pub fn with_json(mut self, topic: &str, change: impl Fn(&mut serde_json::Value)) -> Self {
        let mut changed = 0;
        for message in self.of_mut(topic) {
            let mut content = serde_json::from_slice(&message.data).unwrap();
            change(&mut content);
            message.data = serde_json::to_vec(&content).unwrap();
            changed += 1;
        }
        assert!(changed > 0, "{topic} has no message");
        self
    }

    /// Makes every message of a topic another one, of another schema.
    pub fn replaced<M: prost::Message + foxglove::Encode>(mut self, topic: &str, by: &M) -> Self {
        let schema = M::get_schema().unwrap();
        for message in self.of_mut(topic) {
            message.schema.clone_from(&schema.name);
            message.schema_data = schema.data.to_vec();
            message.data = by.encode_to_vec();
        }
        self
    }

    /// Writes a recording; pictures and the rest in chunks of their own, as a rig does it.
    pub fn write(&self, path: &Path, compression: Option<mcap::Compression>) {
        let file = BufWriter::new(File::create(path).unwrap());
        let options = mcap::WriteOptions::new().compression(compression);
        let options = options.compression_threads(0).chunk_size(None);
        let mut writer = options.profile("scand").create(file).unwrap();
        let mut channels = BTreeMap::new();
        let mut pictures = false;
        for (sequence, message) in (0..).zip(&self.0) {
            let key = (&message.topic, &message.schema, &message.encoding);
            let id = *channels.entry(key).or_insert_with(|| {
                let encoding = match message.encoding.as_str() {
                    "json" => "jsonschema",
                    other => other,
                };
                let schema = writer.add_schema(&message.schema, encoding, &message.schema_data);
                let (topic, encoding) = (&message.topic, &message.encoding);
                writer
                    .add_channel(schema.unwrap(), topic, encoding, &BTreeMap::new())
                    .unwrap()
            });
            if pictures != message.schema.ends_with("Image") {
                pictures = !pictures;
                writer.flush().unwrap();
            }
            let header = MessageHeader {
                channel_id: id,
                sequence,
                log_time: message.log_time,
                publish_time: message.log_time,
            };
            writer
                .write_to_known_channel(&header, &Cow::Borrowed(&message.data[..]))
                .unwrap();
        }
        writer.finish().unwrap();
    }

    /// The bytes of a recording that is not compressed.
    pub fn bytes(&self) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bytes.mcap");
        self.write(&path, None);
        std::fs::read(path).unwrap()
    }
}
