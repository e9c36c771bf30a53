"""Times the network of a weights file in PyTorch on a GPU: forward passes, and training steps like those of
`lsdc bench --training`.

    python scripts/peers/gpu.py WEIGHTS [--size 304x228] [--runs 15]

Prints one JSON object per line. Measures TensorFloat-32, the default of PyTorch's convolutions, and full single
precision."""

import argparse
import json
import statistics
import time

import torch
from pytorch import Network, trainer


def median_ms(run, runs: int) -> float:
    times = []
    for round in range(runs + 3):
        torch.cuda.synchronize()
        started = time.perf_counter()
        run()
        torch.cuda.synchronize()
        if round >= 3:
            times.append(time.perf_counter() - started)
    return round_ms(statistics.median(times))


def round_ms(seconds: float) -> float:
    return round(seconds * 1e3, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights")
    parser.add_argument("--size", default="304x228")
    parser.add_argument("--runs", type=int, default=15)
    args = parser.parse_args()
    width, height = map(int, args.size.split("x"))
    print(json.dumps({"card": torch.cuda.get_device_name(), "torch": torch.__version__}))
    for tf32 in [False, True]:
        torch.backends.cudnn.allow_tf32 = tf32
        torch.backends.cuda.matmul.allow_tf32 = tf32
        torch.backends.cudnn.benchmark = True
        net = Network(args.weights).fold().to("cuda", memory_format=torch.channels_last)
        for batch in [1, 2, 8, 32]:
            image = torch.randn(batch, 3, height, width, device="cuda")
            image = image.to(memory_format=torch.channels_last)
            with torch.inference_mode():
                forward = median_ms(lambda: net(image), args.runs)
            torch.cuda.reset_peak_memory_stats()
            step = None
            if batch > 1:
                step = median_ms(
                    trainer(args.weights, height, width, batch, 1000, "cuda"), args.runs
                )
            peak = torch.cuda.max_memory_allocated() / 1e6
            row = {"tf32": tf32, "batch": batch, "forward_ms": forward, "step_ms": step}
            print(json.dumps(row | {"peak_mb": round(peak)}), flush=True)


if __name__ == "__main__":
    main()
