"""Reads messages of a Foxglove server or an MCAP file, with websockets, mcap and protobuf."""

import asyncio
import base64
import json
import struct
from collections.abc import Collection
from pathlib import Path

import websockets
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

DEADLINE_S = 120.0


def decoded(data, encoding, schema, name):
    """Decode a message by its schema."""
    if encoding == "json":
        return json.loads(data)
    files = descriptor_pb2.FileDescriptorSet.FromString(schema)
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name)).FromString(data)


def read_mcap(path: Path) -> list[tuple[str, int, object]]:
    """Return topic, time in nanoseconds and message, in order of time."""
    found = []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            data, name = (b"", "") if schema is None else (schema.data, schema.name)
            found.append(
                (channel.topic, message.log_time, decoded(message.data, channel.message_encoding, data, name))
            )
    return found


def hear(port: int, topics: Collection[str]) -> dict[str, object]:
    """Subscribe to topics of a server, and wait for a message of each."""
    return asyncio.run(asyncio.wait_for(_hear(port, set(topics)), DEADLINE_S))


async def _hear(port: int, topics: set[str]) -> dict[str, object]:
    channels: dict[int, dict] = {}
    heard: dict[str, object] = {}
    address = f"ws://127.0.0.1:{port}"
    async with websockets.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        while heard.keys() != topics:
            try:
                message = await asyncio.wait_for(socket.recv(), 0.5)
            except TimeoutError:  # a server that has just advertised a channel may not know it yet
                await _subscribe(socket, [n for n, c in channels.items() if c["topic"] not in heard])
                continue
            if isinstance(message, str):
                new = {c["id"]: c for c in json.loads(message).get("channels", []) if c["topic"] in topics}
                channels |= new
                await _subscribe(socket, [*new])
            elif message[0] == 1:  # data of a subscription, after its number and its time
                channel = channels[struct.unpack_from("<I", message, 1)[0]]
                schema = base64.b64decode(channel.get("schema", ""))
                heard[channel["topic"]] = decoded(
                    message[13:], channel["encoding"], schema, channel["schemaName"]
                )
    return heard


async def _subscribe(socket: websockets.ClientConnection, numbers: list[int]) -> None:
    if numbers:
        wanted = [{"id": number, "channelId": number} for number in numbers]
        await socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": numbers}))
        await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
