"""Gives a recording a session with a title that tries readers. Usage: entitle.py RECORDING NEW."""

import sys

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

TITLE = "Krater \u00ab\u0397 \u039d\u03af\u03ba\u03b7\u00bb \"of\" 'Gr\u00f6\u00dfe' \\ 100 % <b> & \U00013000"


def main(source, target):
    with open(source, "rb") as file, open(target, "wb") as new:
        reader = make_reader(file)
        writer = Writer(new, compression=CompressionType.NONE)
        writer.start("scand", reader.get_header().library)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.add_metadata("session", {"name": "interop", "title": TITLE})
        schemas, channels = {}, {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                if schema.id not in schemas:
                    schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()


if __name__ == "__main__":
    main(*sys.argv[1:])
