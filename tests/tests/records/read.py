"""Reads two records with PyPI's `mcap`: one that was ended, and one whose recorder was killed. Prints what is in them as JSON."""

import json
import sys
from collections import Counter

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader


def ended(path):
    topics, schemas, metadata = Counter(), {}, {}
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        profile = reader.get_header().profile
        statistics = reader.get_summary().statistics
        for entry in reader.iter_metadata():
            metadata[entry.name] = entry.metadata
        for schema, channel, message in reader.iter_messages():
            topics[channel.topic] += 1
            if schema is not None:
                schemas[channel.topic] = schema.name
                assert schema.encoding == {"json": "jsonschema"}.get(channel.message_encoding, "protobuf"), schema
            if channel.message_encoding == "json":
                value = json.loads(message.data)
                if schema is not None:
                    wanted = json.loads(schema.data)
                    assert wanted["type"] == "object" and isinstance(value, dict), channel.topic
                    missing = [name for name in wanted.get("required", []) if name not in value]
                    assert not missing, (channel.topic, missing)
    assert sum(topics.values()) == statistics.message_count
    return {"profile": profile, "topics": topics, "schemas": schemas, "metadata": metadata}


def killed(path):
    messages, was_cut_off = 0, False
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                messages += isinstance(record, Message)
        except EndOfFile:
            was_cut_off = True
    return {"messages": messages, "was_cut_off": was_cut_off}


print(json.dumps({"ended": ended(sys.argv[1]), "killed": killed(sys.argv[2])}))
