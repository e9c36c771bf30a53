// A user's program, which checks the types of the installed package.
import { Completer, LsdcError } from "lsdc";
import { Completer as WorkerCompleter, type Completion } from "lsdc/worker";

export async function onWorker(image: ImageData): Promise<Completion> {
  const completer = await WorkerCompleter.load({ weights: "small" });
  const scene = await completer.scene(image, { quality: "best" });
  return scene.complete([[1, 2, 3], [4, 5, 6, 0.1]], { robust: "auto" });
}

export async function here(): Promise<string | null> {
  const scene = (await Completer.load()).scene({ width: 1, height: 1, data: new Uint8Array(3) });
  try {
    return String(scene.complete(new Float32Array(3), { columns: 3 }).depth[0]);
  } catch (error) {
    return error instanceof LsdcError ? error.hint : null;
  }
}

// @ts-expect-error: there are no such weights
void Completer.load({ weights: "tiny" });
