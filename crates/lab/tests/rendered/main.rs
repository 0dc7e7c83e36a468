//! Rooms that see pictures, each on rendered ones whose truth is known: silhouettes, crowded corners of a board, and
//! what the report says of sound and of faulty captures. The whole method is in the root's
//! `tests/offline/reconstruction.rs`.

mod crowded_corners;
mod silhouettes;
mod verdict;
