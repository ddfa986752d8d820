"""Tiny Grounding DINO, SAM 2 and SAM 3 with random weights, saved as the published folders are."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
import transformers
from safetensors.torch import save_file

SIDE = 64  # of the images SAM 2 looks at [px]


def save_tiny_grounded_sam2(folder: Path) -> Path:
    """Write `folder`/grounding-dino and `folder`/sam2 (0.3 million parameters each) and return `folder`."""
    torch.manual_seed(0)
    with _no_bars():
        _save_detector(folder / "grounding-dino")
        _save_outliner(folder / "sam2")
    return folder


def save_tiny_sam3(folder: Path) -> Path:
    """Write `folder`/sam3 (0.3 million parameters) as a part of the video model, as it is published."""
    torch.manual_seed(1)
    small = {"hidden_size": 32, "num_layers": 1, "num_attention_heads": 2, "intermediate_size": 32}
    config = transformers.Sam3Config(
        vision_config={
            "backbone_config": {
                "model_type": "sam3_vit_model", "hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 2,
                "num_attention_heads": 2, "image_size": 56, "patch_size": 14, "window_size": 2,
                "global_attn_indexes": [1], "pretrain_image_size": 28,
            },
            "fpn_hidden_size": 32, "backbone_feature_sizes": [[16, 16], [8, 8], [4, 4]],
        },
        text_config={
            "model_type": "clip_text_model", "vocab_size": 100, "hidden_size": 32, "intermediate_size": 32,
            "projection_dim": 16, "num_hidden_layers": 1, "num_attention_heads": 2, "max_position_embeddings": 32,
            "hidden_act": "gelu", "bos_token_id": 98, "eos_token_id": 99,
        },
        geometry_encoder_config=small, detr_encoder_config=small, detr_decoder_config=small | {"num_queries": 10},
        mask_decoder_config={"hidden_size": 32, "num_attention_heads": 2},
    )  # fmt: skip
    network = transformers.Sam3Model(config)
    place = folder / "sam3"
    place.mkdir(parents=True)
    numbers = {f"detector_model.{name}": value.contiguous() for name, value in network.state_dict().items()}
    save_file(numbers | {"tracker_model.x": torch.zeros(1)}, place / "model.safetensors", metadata={"format": "pt"})
    (place / "config.json").write_text(json.dumps({"model_type": "sam3_video", "detector_config": config.to_dict()}))
    letters = [chr(97 + k) for k in range(26)]
    vocabulary = [*letters, *(f"{k}</w>" for k in letters), *(f"[unused{k}]" for k in range(46))]
    ids = {token: i for i, token in enumerate([*vocabulary, "<|startoftext|>", "<|endoftext|>"])}
    transformers.CLIPTokenizer(vocab=ids, merges=[]).save_pretrained(place)
    return folder


@contextmanager
def _no_bars() -> Iterator[None]:
    transformers.utils.logging.disable_progress_bar()
    try:
        yield
    finally:
        transformers.utils.logging.enable_progress_bar()


def _save_detector(folder: Path) -> None:
    folder.mkdir(parents=True)
    words = {101: "[CLS]", 102: "[SEP]", 1012: ".", 1029: "?", 0: "[PAD]", 100: "[UNK]", 103: "[MASK]"}
    words |= {200: "lea", 201: "##ves", 202: "stem", 203: "flower"}  # the model knows the first four by number
    vocabulary = {words.get(i, f"[unused{i}]"): i for i in range(1031)}
    transformers.BertTokenizer(vocab=vocabulary).save_pretrained(folder)
    transformers.GroundingDinoImageProcessorPil(size={"shortest_edge": 64, "longest_edge": 128}).save_pretrained(folder)
    small = {"encoder_ffn_dim": 16, "decoder_ffn_dim": 16, "encoder_attention_heads": 2, "decoder_attention_heads": 2}
    config = transformers.GroundingDinoConfig(
        backbone_config=transformers.SwinConfig(
            image_size=64, embed_dim=12, depths=[1, 1, 1, 1], num_heads=[1, 2, 2, 2], window_size=4,
            out_features=["stage2", "stage3", "stage4"],
        ),
        text_config=transformers.BertConfig(
            vocab_size=1031, hidden_size=16, num_hidden_layers=1, num_attention_heads=2, intermediate_size=16
        ),
        d_model=32, encoder_layers=1, decoder_layers=2, num_queries=12, **small,
    )  # fmt: skip
    transformers.GroundingDinoForObjectDetection(config).save_pretrained(folder)


def _save_outliner(folder: Path) -> None:
    """As the published folders are: of the video model, of which single images need a part."""
    backbone = transformers.Sam2HieraDetConfig(
        hidden_size=8, num_attention_heads=1, image_size=[SIDE, SIDE], blocks_per_stage=[1, 2, 2, 1],
        embed_dim_per_stage=[8, 16, 32, 64], num_attention_heads_per_stage=[1, 1, 2, 2],
        window_size_per_stage=[4, 4, 4, 2], window_positional_embedding_background_size=[4, 4],
        global_attention_blocks=[4],  # not the first block of a stage: its window would be divided by 0
    )  # fmt: skip
    vision = transformers.Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], fpn_hidden_size=16,
        backbone_feature_sizes=[[16, 16], [8, 8], [4, 4]],
    )  # fmt: skip
    memory = {
        "memory_attention_hidden_size": 16, "memory_attention_feed_forward_hidden_size": 16,
        "memory_attention_num_layers": 1, "memory_encoder_hidden_size": 16, "memory_encoder_output_channels": 8,
        "mask_downsampler_embed_dim": 16, "memory_fuser_embed_dim": 16, "memory_fuser_intermediate_dim": 16,
    }  # fmt: skip
    config = transformers.Sam2VideoConfig(
        vision_config=vision,
        prompt_encoder_config={"hidden_size": 16, "image_size": SIDE, "patch_size": 16},
        mask_decoder_config={"hidden_size": 16, "mlp_dim": 16, "num_attention_heads": 2, "iou_head_hidden_dim": 16},
        image_size=SIDE,
        **memory,
    )
    transformers.Sam2VideoModel(config).save_pretrained(folder)
