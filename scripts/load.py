#!/usr/bin/env python3
"""Load test of `lsdc serve` on this machine: many clients, every answer checked against the program's own file.

    python3 scripts/load.py --program target/release/lsdc --seconds 60 --clients 8

Clients send requests without a pause, some for direct completions, some for completions of scenes; clients that are refused
with 429 wait for a part of Retry-After. Prints one line of JSON: answers per second, times, refusals, wrong answers, memory of
the service. With --kill, the service is killed (SIGKILL) and restarted halfway; later answers must be correct.
"""

import argparse
import asyncio
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOM = Path(__file__).resolve().parents[1] / "assets/room"
BOUNDARY = "load"


def form(**parts) -> bytes:
    body = b""
    for name, content in parts.items():
        file = f'; filename="{content.name}"' if isinstance(content, Path) else ""
        head = f'--{BOUNDARY}\r\ncontent-disposition: form-data; name="{name}"{file}\r\n\r\n'
        content = content.read_bytes() if isinstance(content, Path) else content.encode()
        body += head.encode() + content + b"\r\n"
    return body + f"--{BOUNDARY}--\r\n".encode()


class Service:
    """The program under test."""

    def __init__(self, program: str, options: list):
        self.program, self.options = program, options
        self.start()

    def start(self) -> None:
        command = [self.program, "--quiet", "serve", "--listen", "127.0.0.1:0", *self.options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.port = int(re.search(r":(\d+)\s*$", line).group(1))

    def memory(self, name: str) -> float:
        """Returns VmRSS or VmHWM in MiB; 0 if the system does not provide it, or the process has ended."""
        try:
            text = Path(f"/proc/{self.process.pid}/status").read_text()
        except OSError:
            return 0.0
        found = re.search(rf"{name}:\s+(\d+) kB", text)
        return int(found.group(1)) / 1024 if found else 0.0

    def restart(self) -> None:
        self.process.kill()
        self.process.wait()
        self.start()

    def end(self) -> int:
        self.process.terminate()
        return self.process.wait(timeout=60)


async def ask(port: int, path: str, body: bytes, accept: str) -> tuple:
    """Returns status, headers and body of an answer."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    head = (
        f"POST {path} HTTP/1.1\r\nhost: 127.0.0.1:{port}\r\nconnection: close\r\naccept: {accept}\r\n"
        f"content-type: multipart/form-data; boundary={BOUNDARY}\r\ncontent-length: {len(body)}\r\n\r\n"
    )
    try:
        writer.write(head.encode() + body)
        await writer.drain()
        answer = await reader.read()
    finally:
        writer.close()
    head, separator, content = answer.partition(b"\r\n\r\n")
    if not separator:
        raise ConnectionError("no answer")
    lines = head.decode().split("\r\n")
    headers = dict(line.lower().split(": ", 1) for line in lines[1:])
    if int(headers.get("content-length", len(content))) != len(content):
        raise ConnectionError("half an answer")
    return int(lines[0].split()[1]), headers, content


class Tally:
    def __init__(self):
        self.times, self.refused, self.wrong, self.broken = [], 0, 0, 0


async def client(service: Service, number: int, until: float, right: bytes, tally: Tally) -> None:
    whole = form(image=ROOM / "rgb.png", points=ROOM / "sparse.npy")
    points = form(points=ROOM / "sparse.npy")
    scene = None
    while time.monotonic() < until:
        started = time.monotonic()
        try:
            if number % 2 and scene is None:
                status, headers, _ = await ask(service.port, "/v1/scenes", form(image=ROOM / "rgb.png"), "*/*")
                if status == 201:
                    scene = headers["location"] + "/complete"
                    continue
            else:
                path, body = (scene, points) if number % 2 else ("/v1/complete", whole)
                status, headers, content = await ask(service.port, path, body, "image/png")
        except OSError:
            tally.broken += 1
            await asyncio.sleep(0.05)
            continue
        if status == 429:
            tally.refused += 1
            await asyncio.sleep(float(headers["retry-after"]) / 4)
        elif status == 404 and number % 2:
            scene = None
        elif status == 200 and content == right:
            tally.times.append(time.monotonic() - started)
        else:
            tally.wrong += 1


def expected(program: str) -> bytes:
    """Returns the file that the program writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "depth.png"
        command = [program, "--quiet", "complete", ROOM / "rgb.png", ROOM / "sparse.npy", "-o", path]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return path.read_bytes()


async def run(args: argparse.Namespace) -> dict:
    right = expected(args.program)
    service = Service(args.program, args.options)
    tally, memory = Tally(), []
    started = time.monotonic()
    until = started + args.seconds
    clients = [client(service, number, until, right, tally) for number in range(args.clients)]

    async def watch() -> None:
        killed = not args.kill
        while time.monotonic() < until:
            memory.append(service.memory("VmRSS"))
            await asyncio.sleep(args.seconds / 40)
            if not killed and time.monotonic() > until - args.seconds / 2:
                killed = True
                service.restart()

    await asyncio.gather(watch(), *clients)
    most = service.memory("VmHWM")
    code = service.end()
    times = sorted(tally.times)
    at = lambda share: round(times[min(int(share * len(times)), len(times) - 1)], 3) if times else None
    return {
        "seconds": round(time.monotonic() - started, 1),
        "clients": args.clients,
        "cores": os.cpu_count(),
        "right": len(times),
        "a_second": round(len(times) / args.seconds, 2),
        "p50_s": at(0.5),
        "p99_s": at(0.99),
        "refused_429": tally.refused,
        "broken_connections": tally.broken,
        "wrong": tally.wrong,
        "rss_mib": {"quarter": round(memory[len(memory) // 4]), "end": round(memory[-1]), "most": round(most)},
        "exit": code,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="target/release/lsdc")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--clients", type=int, default=8)
    parser.add_argument("--kill", action="store_true", help="kill the service in the middle, and start it again")
    parser.add_argument("options", nargs="*", help="options of lsdc serve, after --")
    result = asyncio.run(run(parser.parse_args()))
    print(json.dumps(result))
    return 1 if result["wrong"] or not result["right"] or result["exit"] else 0


if __name__ == "__main__":
    sys.exit(main())
