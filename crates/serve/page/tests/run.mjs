// Bundles the tests of a folder and runs them: `node tests/run.mjs unit|browser [name...]`.
import { build } from "esbuild";
import { spawnSync } from "node:child_process";
import { readdir, rm } from "node:fs/promises";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const [which = "unit", ...names] = process.argv.slice(2);
const page = fileURLToPath(new URL("..", import.meta.url));
// Inside the project, so that packages are found.
const outdir = join(page, "node_modules/.cache/lsdc-tests", which);
const files = (await readdir(join(page, "tests", which))).filter((name) => name.endsWith(".test.ts"));
const chosen = files.filter((file) => names.length === 0 || names.some((name) => file.startsWith(name)));
await rm(outdir, { recursive: true, force: true });
await build({
  absWorkingDir: page,
  entryPoints: chosen.map((file) => join("tests", which, file)),
  outdir,
  outExtension: { ".js": ".mjs" },
  bundle: true,
  platform: "node",
  format: "esm",
  target: "node20",
  packages: "external",
  loader: { ".css": "empty" },
  logLevel: "warning",
});
const bundled = (await readdir(outdir)).map((file) => join(outdir, file));
const { status } = spawnSync(process.execPath, ["--test", "--test-concurrency=1", ...bundled], { stdio: "inherit" });
process.exit(status ?? 1);
