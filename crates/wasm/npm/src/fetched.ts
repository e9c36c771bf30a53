// Fetches files of the package and of users.

import { LsdcError } from "./error.ts";

interface Host {
  readonly process?: { getBuiltinModule?(name: "node:fs/promises"): { readFile(path: URL): Promise<Uint8Array> } };
}

/** Fetches the bytes at an address; Node.js reads files from disk. */
export async function fetched(address: URL, what: string): Promise<Uint8Array> {
  const hint = `check that ${address.href} is there, and that this page may read it`;
  try {
    const files = address.protocol === "file:" ? (globalThis as Host).process?.getBuiltinModule?.("node:fs/promises") : undefined;
    if (files) return await files.readFile(address);
    const reply = await fetch(address);
    if (reply.ok) return new Uint8Array(await reply.arrayBuffer());
    throw new LsdcError("load", `${what} cannot be fetched: status ${reply.status}`, hint);
  } catch (cause) {
    if (cause instanceof LsdcError) throw cause;
    throw new LsdcError("load", `${what} cannot be fetched: ${cause instanceof Error ? cause.message : String(cause)}`, hint, { cause });
  }
}
