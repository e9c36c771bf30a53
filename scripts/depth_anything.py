"""Depth Anything V2 under the names of `transformers`, from tensors with the published names of DINOv2 and of the depth head."""

import torch


def encoder_names(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    theirs = {}
    for name, value in tensors.items():
        name = name.replace("cls_token", "embeddings.cls_token").replace(
            "pos_embed", "embeddings.position_embeddings").replace(
            "patch_embed.proj", "embeddings.patch_embeddings.projection")
        if name.startswith("blocks."):
            name = "encoder.layer." + name.removeprefix("blocks.")
        name = name.replace("attn.proj", "attention.o_proj").replace(
            "ls1.gamma", "layer_scale1.lambda1").replace("ls2.gamma", "layer_scale2.lambda1")
        if name.startswith("norm."):
            name = "layernorm." + name.removeprefix("norm.")
        if ".attn.qkv" in name:
            for part, third in zip(("q_proj", "k_proj", "v_proj"), value.chunk(3)):
                theirs[name.replace("attn.qkv", f"attention.{part}")] = third
        else:
            theirs[name] = value
    return theirs


def head_names(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    theirs = {}
    for name, value in tensors.items():
        part, number, *rest = name.removeprefix("scratch.").replace("_rn", "").split(".")
        if part == "projects":
            to = ["neck.reassemble_stage.layers", number, "projection"]
        elif part == "resize_layers":
            to = ["neck.reassemble_stage.layers", number, "resize"]
        elif part.startswith("layer"):
            to, rest = ["neck.convs", str(int(part[-1]) - 1)], [number]
        elif part.startswith("refinenet"):
            # The layers of `transformers` begin with the coarsest.
            to = ["neck.fusion_stage.layers", str(4 - int(part[-1]))]
            to.append("projection" if number == "out_conv" else f"residual_layer{number[-1]}")
            rest = [of.replace("conv", "convolution") for of in rest]
        elif part == "output_conv1":
            to, rest = ["head.conv1"], [number]
        else:
            to = [{"0": "head.conv2", "2": "head.conv3"}[number]]
        theirs[".".join(to + rest)] = value
    return theirs
