"""The network of a weights file as an ONNX graph, with normalisation folded into the weights."""

import json

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from safetensors.numpy import load_file
from safetensors import safe_open

EPSILON = 1e-5


class Graph:
    """Collects nodes and constants."""

    def __init__(self, tensors: dict[str, np.ndarray]):
        self.tensors = {name: t.astype(np.float32) for name, t in tensors.items()}
        self.nodes = []
        self.constants = []

    def constant(self, value: np.ndarray) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(value, name))
        return name

    def add(self, kind: str, *inputs: str, **attributes) -> str:
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def line(self, norm: str) -> tuple[np.ndarray, np.ndarray]:
        """Returns the slope and offset of a batch normalisation."""
        part = {
            key: self.tensors[f"{norm}.Batch.{key}"].astype(np.float64)
            for key in ("gain", "shift", "running_mean", "running_variance")
        }
        slope = part["gain"] / np.sqrt(part["running_variance"] + EPSILON)
        return slope, part["shift"] - part["running_mean"] * slope

    def conv(self, x: str, name: str, stride=1, dilation=1, relu=True, groups=1) -> str:
        weight = self.tensors[f"{name}.conv.weight"].astype(np.float64)
        slope, offset = self.line(f"{name}.norm")
        weight = weight * slope[:, None, None, None]
        return self.plain(x, weight, offset, stride, dilation, relu, groups)

    def plain(self, x: str, weight: np.ndarray, bias, stride=1, dilation=1, relu=False, groups=1) -> str:
        taps = weight.shape[2]
        pad = dilation * (taps // 2)
        inputs = [x, self.constant(weight.astype(np.float32))]
        if bias is not None:
            inputs.append(self.constant(bias.astype(np.float32)))
        x = self.add(
            "Conv",
            *inputs,
            strides=[stride] * 2,
            dilations=[dilation] * 2,
            pads=[pad] * 4,
            group=groups,
        )
        return self.add("Relu", x) if relu else x

    def resize(self, x: str, height: int, width: int, channels: int) -> str:
        sizes = self.constant(np.array([1, channels, height, width], np.int64))
        return self.add(
            "Resize",
            x,
            "",
            "",
            sizes,
            mode="linear",
            coordinate_transformation_mode="half_pixel",
        )


def backbone_blocks(stages: int) -> list[dict]:
    """Returns the blocks of EfficientNet-Lite0: stride, whether the input is added, and whether the output is used."""
    # Stride of the first block and number of blocks.
    sizes = [(1, 1), (2, 2), (2, 2), (2, 3), (1, 3), (2, 4), (1, 1)]
    blocks = []
    for first, count in sizes[:stages]:
        for i in range(count):
            stride = first if i == 0 else 1
            if len(blocks) > 1:
                blocks[-1]["read"] = stride == 2
            blocks.append({"stride": stride, "adds": i > 0, "read": False})
    blocks[-1]["read"] = True
    return blocks


def seen_by_backbone(graph: Graph, image: str, stages: int) -> list[str]:
    x = graph.conv(image, "extractor.backbone.stem", stride=2)
    maps = []
    for i, block in enumerate(backbone_blocks(stages)):
        at = f"extractor.backbone.blocks.{i}"
        y = graph.conv(x, f"{at}.expand") if f"{at}.expand.conv.weight" in graph.tensors else x
        inner = graph.tensors[f"{at}.depthwise.conv.weight"].shape[0]
        y = graph.conv(y, f"{at}.depthwise", stride=block["stride"], groups=inner)
        y = graph.conv(y, f"{at}.project", relu=False)
        x = graph.add("Add", y, x) if block["adds"] else y
        if block["read"]:
            maps.append(x)
    return maps


def pyramid(graph: Graph, maps: list[str], size: tuple[int, int], channels: int) -> str:
    """Returns the last level of the feature pyramid, which has the size of the first map."""
    sizes = [size]
    for _ in maps[1:]:
        sizes.append(tuple((n + 1) // 2 for n in sizes[-1]))
    x = None
    for i, (map, (h, w)) in reversed(list(enumerate(zip(maps, sizes)))):
        lateral = graph.plain(map, graph.tensors[f"extractor.decoder.lateral.{i}.weight"], None)
        if x:
            lateral = graph.add("Add", lateral, graph.resize(x, h, w, channels))
        x = graph.conv(lateral, f"extractor.decoder.mix.{i}")
    return x


def encode(height: int, width: int, octaves: int) -> np.ndarray:
    """Returns the positional encoding `[1, 4 octaves, height, width]`."""

    def axis(length: int) -> np.ndarray:
        c = (2 * np.arange(length) + 1) / length - 1
        waves = [f(2**k * np.pi * c) for k in range(octaves - 1) for f in (np.sin, np.cos)]
        return np.stack([c, c, *waves])

    columns = np.broadcast_to(axis(width)[:, None, :], (2 * octaves, height, width))
    rows = np.broadcast_to(axis(height)[:, :, None], (2 * octaves, height, width))
    return np.concatenate([columns, rows])[None].astype(np.float32)


def build(weights: str, height: int, width: int) -> onnx.ModelProto:
    """Builds the graph: image `[1, 3, height, width]` to basis functions `[1, N, height, width]`, after the mean, if any."""
    with safe_open(weights, "np") as file:
        config = json.loads(file.metadata()["network"])
    graph = Graph(load_file(weights))
    extractor = config["extractor"]
    half = lambda n: (n + 1) // 2
    h, w = half(half(height)), half(half(width))

    def block(x: str, at: str, stride: int, dilation: int) -> str:
        y = graph.conv(x, f"{at}.first", stride=stride, dilation=dilation)
        y = graph.conv(y, f"{at}.second", dilation=dilation, relu=False)
        if f"{at}.shortcut.conv.weight" in graph.tensors:
            x = graph.conv(x, f"{at}.shortcut", stride=stride, relu=False)
        return graph.add("Add", y, x)

    x = "image"
    for i in range(3):
        x = graph.conv(x, f"extractor.stem.{i}", stride=2 if i == 0 else 1)
    taps = []
    for stage, (name, stride, dilation) in enumerate(
        [("half", 1, 1), ("quarter", 2, 1), ("wide", 1, 1), ("dilated", 1, 2)]
    ):
        for i in range(extractor["stages"][stage]["blocks"]):
            x = block(x, f"extractor.{name}.{i}", stride if i == 0 else 1, dilation)
        taps.append(x)
    raw, skip = taps[1], taps[3]
    parts = [raw, skip]
    for i, pool in enumerate(extractor["pools"]):
        y = graph.add(
            "AveragePool",
            skip,
            kernel_shape=[pool] * 2,
            strides=[pool] * 2,
            ceil_mode=1,
            count_include_pad=0,
        )
        y = graph.conv(y, f"extractor.branches.{i}")
        parts.append(graph.resize(y, h, w, extractor["branch"]))
    x = graph.add("Concat", *parts, axis=1)
    x = graph.conv(x, "extractor.merge")
    x = graph.plain(x, graph.tensors["extractor.project.weight"], None)
    y = skip
    for i, stage in enumerate(extractor.get("context", [])):
        for j in range(stage["blocks"]):
            y = block(y, f"extractor.context.{i}.blocks.{j}", 2 if j == 0 else 1, 1)
        seen = graph.plain(y, graph.tensors[f"extractor.context.{i}.project.weight"], None)
        x = graph.add("Add", x, graph.resize(seen, h, w, extractor["features"]))
    logarithm = None
    if backbone := extractor.get("backbone"):
        maps = seen_by_backbone(graph, "image", backbone["stages"])
        decoded = pyramid(graph, maps, (h, w), backbone["decoder"])
        seen = graph.plain(decoded, graph.tensors["extractor.decoder.features.weight"], None)
        x = graph.add("Add", x, graph.resize(seen, h, w, extractor["features"]))
        if config.get("mean"):
            logarithm = graph.plain(decoded, graph.tensors["extractor.decoder.map.weight"], None)
    # Absent from old files.
    sharpening = extractor.get("sharpening", 0)
    if sharpening > 0:
        x = graph.resize(x, half(height), half(width), extractor["features"])
        if logarithm:
            logarithm = graph.resize(logarithm, half(height), half(width), 1)
        lateral = graph.tensors["extractor.sharpen.lateral.weight"]
        y = graph.add("Add", x, graph.plain(taps[0], lateral, None))
        for i in range(sharpening):
            y = graph.conv(y, f"extractor.sharpen.mix.{i}")
        y = graph.plain(y, graph.tensors["extractor.sharpen.last.weight"], None)
        x = graph.add("Add", x, y)
    x = graph.resize(x, height, width, extractor["features"])
    codes = graph.constant(encode(height, width, config["octaves"]))
    x = graph.add("Concat", x, codes, axis=1)
    for i in range(len(config["hidden"])):
        weight = graph.tensors[f"head.hidden.{i}.linear.weight"].astype(np.float64)
        slope, offset = graph.line(f"head.hidden.{i}.norm")
        x = graph.plain(x, (weight * slope).T[:, :, None, None], offset, relu=True)
    last = graph.tensors["head.last.weight"].T[:, :, None, None]
    bases = graph.plain(x, last, None)
    if config.get("mean"):
        if logarithm:
            logarithm = graph.resize(logarithm, height, width, 1)
        else:
            mean = graph.tensors["head.mean.weight"].T[:, :, None, None]
            logarithm = graph.plain(x, mean, None)
        bases = graph.add("Concat", graph.add("Exp", logarithm), bases, axis=1)
    graph.nodes[-1].output[0] = "bases"

    tensor = lambda name, channels: helper.make_tensor_value_info(
        name, TensorProto.FLOAT, [1, channels, height, width]
    )
    body = helper.make_graph(
        graph.nodes,
        "lsdc",
        [tensor("image", 3)],
        [tensor("bases", config["bases"] + bool(config.get("mean")))],
        graph.constants,
    )
    model = helper.make_model(body, opset_imports=[helper.make_opsetid("", 19)], ir_version=9)
    onnx.checker.check_model(model)
    return model
