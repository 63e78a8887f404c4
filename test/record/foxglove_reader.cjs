// Reads an MCAP file with the libraries of Foxglove's application; one line of JSON for each message.
//
//   NODE_PATH=$(npm root --global) node foxglove_reader.cjs FILE.mcap
//
// A number that JSON does not have (NaN, Infinity) and one of 64 bits are written as text.
"use strict";
const fs = require("node:fs/promises");
const { McapIndexedReader } = require("@mcap/core");
const { FileHandleReadable } = require("@mcap/nodejs");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

function plain(_key, value) {
  if (typeof value === "bigint") return String(value);
  if (typeof value === "number" && !Number.isFinite(value)) return String(value);
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
}

async function main() {
  const readable = new FileHandleReadable(await fs.open(process.argv[2], "r"));
  const decompressHandlers = await loadDecompressHandlers();
  const mcap = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const readers = new Map();
  for (const channel of mcap.channelsById.values()) {
    const schema = mcap.schemasById.get(channel.schemaId);
    if (schema.encoding !== "ros2msg" || channel.messageEncoding !== "cdr") {
      throw new Error(`${channel.topic}: ${schema.encoding}, ${channel.messageEncoding}`);
    }
    const types = parse(new TextDecoder().decode(schema.data), { ros2: true });
    readers.set(channel.id, new MessageReader(types, { timeType: "sec,nanosec" }));
  }
  for await (const message of mcap.readMessages()) {
    const { topic } = mcap.channelsById.get(message.channelId);
    const value = readers.get(message.channelId).readMessage(message.data);
    process.stdout.write(JSON.stringify([topic, message.logTime, value], plain) + "\n");
  }
}

main().catch((error) => {
  console.error(String(error));
  process.exitCode = 1;
});
