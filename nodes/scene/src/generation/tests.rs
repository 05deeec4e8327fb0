//! Tests of `scene_generation` as the engine calls it.
