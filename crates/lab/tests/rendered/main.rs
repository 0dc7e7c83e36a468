//! Tests of rooms that process pictures, on rendered pictures whose truth is known: silhouettes, crowded corners of a
//! board, corners in noisy pictures, one object in several poses, props that are ignored, reports on captures with and
//! without faults, whether surfaces are as good as promised, also that of a relief, whether an atlas wastes little, and
//! whether the errors that models state are true. The whole method is tested in the root's
//! `tests/offline/reconstruction.rs`.

mod atlas;
mod crowded_corners;
mod error_trial;
mod ignored;
mod noisy_corners;
mod poses;
mod relief;
mod silhouettes;
mod surface_trial;
mod verdict;
mod verdict_trial;
