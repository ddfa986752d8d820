"""Tiny Grounding DINO and SAM 2 with random weights, saved as the published folders are, so that real code runs."""

from __future__ import annotations

from pathlib import Path

import torch
import transformers

SIDE = 64  # of the images SAM 2 looks at [px]


def save_tiny_networks(folder: Path) -> Path:
    """Write `folder`/grounding-dino and `folder`/sam2 (0.3 million parameters each) and return `folder`."""
    torch.manual_seed(0)
    bars = transformers.utils.logging
    bars.disable_progress_bar()
    try:
        _save_detector(folder / "grounding-dino")
        _save_outliner(folder / "sam2")
    finally:
        bars.enable_progress_bar()
    return folder


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
