// Reads the topics of `lsdc node --foxglove` with Foxglove's own packages: client and message reader.
//
//     npm install @foxglove/ws-protocol@0.8.0 @foxglove/rosmsg@5.0.5 @foxglove/rosmsg2-serialization@3.1.0 ws@8.23.0
//     node scripts/peers/foxglove.mjs ws://127.0.0.1:8765 /lsdc/depth/image,/diagnostics [SECONDS]
//
// Waits for the server, subscribes to all channels, and decodes every message by the definition of its channel, until each
// topic has been received three times. Foxglove's panels are not tested.

import { createRequire } from "node:module";
import { resolve } from "node:path";

// Packages are loaded from the working folder.
const load = createRequire(resolve("package.json"));
const { FoxgloveClient } = load("@foxglove/ws-protocol");
const { parse } = load("@foxglove/rosmsg");
const { MessageReader } = load("@foxglove/rosmsg2-serialization");
const WebSocket = load("ws");

const [address, topics, seconds = "120"] = process.argv.slice(2);
const wanted = topics.split(",");
const counts = new Map();
const late = setTimeout(() => fail(`not all of ${topics} came: ${JSON.stringify([...counts])}`), 1000 * Number(seconds));

function fail(what) {
  console.error(what);
  process.exit(1);
}

function check(kind, message) {
  if (kind.endsWith("/Image") && message.encoding === "32FC1") {
    const depths = new Float32Array(message.data.slice().buffer);
    if (depths.length !== message.width * message.height || !depths.every((depth) => depth >= 0 && depth < 1000)) {
      fail("an image of depths is none");
    }
  }
  if (kind.endsWith("/PointCloud2") && message.data.length !== message.row_step * message.height) fail("a cloud is none");
}

function connect() {
  const socket = new WebSocket(address, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
  const client = new FoxgloveClient({ ws: socket });
  const channels = new Map();
  client.on("error", (error) => (error.code === "ECONNREFUSED" ? setTimeout(connect, 300) : fail(String(error))));
  client.on("advertise", (found) => {
    for (const { id, topic, encoding, schema, schemaName } of found) {
      const reader = new MessageReader(parse(schema, { ros2: true }));
      if (encoding !== "cdr") fail(`${topic} is ${encoding}`);
      channels.set(client.subscribe(id), { topic, reader, schemaName });
    }
  });
  client.on("message", ({ subscriptionId, data }) => {
    const { topic, reader, schemaName } = channels.get(subscriptionId);
    check(schemaName, reader.readMessage(data));
    counts.set(topic, (counts.get(topic) ?? 0) + 1);
    if (wanted.every((name) => counts.get(name) >= 3)) {
      clearTimeout(late);
      console.log("decoded", Object.fromEntries(counts));
      client.close();
      process.exit(0);
    }
  });
}

connect();
