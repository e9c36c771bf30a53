// Builds `dist`: the module with cargo, JavaScript and types with tsc, and copies of the weights.
//
//     node build.mjs            needs Rust with the target wasm32-unknown-unknown, and `npm ci`
import { execFileSync } from "node:child_process";
import { cpSync, mkdirSync, rmSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const here = fileURLToPath(new URL(".", import.meta.url));
const root = join(here, "../../..");
const target = process.env.CARGO_TARGET_DIR ?? join(root, "target");
const dist = join(here, "dist");
const run = (command, args, env = {}) =>
  execFileSync(command, args, { cwd: here, stdio: "inherit", env: { ...process.env, ...env } });

rmSync(dist, { recursive: true, force: true });
run("cargo", ["build", "--release", "--locked", "--target", "wasm32-unknown-unknown", "-p", "lsdc-wasm"], {
  CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS: "-Ctarget-feature=+simd128",
});
run(process.execPath, [join(here, "node_modules/typescript/bin/tsc")]);
mkdirSync(join(dist, "weights"));
cpSync(join(target, "wasm32-unknown-unknown/release/lsdc_wasm.wasm"), join(dist, "lsdc.wasm"));
for (const name of ["default", "small"]) {
  cpSync(join(root, `crates/core/weights/${name}.safetensors`), join(dist, `weights/${name}.safetensors`));
}
for (const name of ["LICENSE-APACHE", "LICENSE-MIT", "NOTICE"]) cpSync(join(root, name), join(here, name));
