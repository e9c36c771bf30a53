// Builds `dist`, which is committed and embedded in the program. `--check` builds into a temporary folder and fails if a byte
// differs; the output depends on sources and lock file alone. `--web FOLDER` builds the page as static files, with demo scenes
// and the module and weights of the npm package, which must be built first.
import { build } from "esbuild";
import { cp, mkdir, mkdtemp, readFile, readdir, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { scenes } from "./demos.mjs";

const here = fileURLToPath(new URL(".", import.meta.url));
const committed = join(here, "dist");
const LARGEST = 1_000_000;

/** Builds the page; with `others`, further scripts, as static files that need no program. */
async function into(folder, others = null) {
  await build({
    absWorkingDir: here,
    entryPoints: { app: "src/main.ts", ...others },
    outdir: folder,
    define: { STATIC: String(others !== null) },
    bundle: true,
    splitting: others !== null,
    minify: true,
    format: "esm",
    target: ["es2022", "chrome123", "firefox120", "safari17.5"],
    charset: "utf8",
    legalComments: "none",
    logLevel: "warning",
  });
  for (const file of ["index.html", "icon.svg"]) await cp(join(here, "src", file), join(folder, file));
}

async function contents(folder) {
  const names = (await readdir(folder)).sort();
  return new Map(await Promise.all(names.map(async (name) => [name, await readFile(join(folder, name))])));
}

async function web(folder) {
  const [npm, room] = [join(here, "../../wasm/npm"), join(here, "../../../assets/room")];
  await mkdir(folder, { recursive: true });
  await into(folder, { thread: join(npm, "src/thread.ts") });
  for (const file of ["lsdc.wasm", "weights/default.safetensors"]) await cp(join(npm, "dist", file), join(folder, file));
  for (const file of ["rgb.png", "sparse.npy"]) await cp(join(room, file), join(folder, "demo/room", file));
  const demos = [{ name: "room", title: "A rendered room, 500 depths", image: "demo/room/rgb.png", points: "demo/room/sparse.npy" }];
  for (const { name, title, image, points } of scenes()) {
    const demo = { name, title, image: `demo/${name}/rgb.png`, points: `demo/${name}/points.csv` };
    await mkdir(join(folder, "demo", name), { recursive: true });
    await writeFile(join(folder, demo.image), image);
    await writeFile(join(folder, demo.points), ["u,v,depth", ...points, ""].join("\n"));
    demos.push(demo);
  }
  await writeFile(join(folder, "demo/demos.json"), JSON.stringify(demos));
  // The program answers here with the files that it opened; this answer says that there is no program.
  await mkdir(join(folder, "v1"), { recursive: true });
  await writeFile(join(folder, "v1/start"), JSON.stringify({ browser: true }));
}

if (process.argv[2] === "--web") {
  await web(process.argv[3]);
  process.exit();
}
const check = process.argv.includes("--check");
const folder = check ? await mkdtemp(join(tmpdir(), "lsdc-page-")) : committed;
if (!check) await rm(folder, { recursive: true, force: true });
await into(folder);
const made = await contents(folder);
const bytes = [...made.values()].reduce((sum, file) => sum + file.length, 0);
console.log(`${made.size} files, ${(bytes / 1000).toFixed(1)} kB`);
if (bytes > LARGEST) throw new Error(`the page has ${bytes} bytes, more than ${LARGEST}`);
if (check) {
  const there = await contents(committed);
  const names = new Set([...made.keys(), ...there.keys()]);
  const different = [...names].filter((name) => !made.get(name)?.equals(there.get(name) ?? Buffer.of()));
  await rm(folder, { recursive: true });
  if (different.length > 0) throw new Error(`dist is out of date (npm run build): ${different.join(", ")}`);
  console.log("dist is up to date");
}
