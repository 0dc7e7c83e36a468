//! Tests of rooms that process pictures, on rendered pictures whose truth is known: silhouettes, crowded corners of
//! a board, and reports on captures with and without faults. The whole method is tested in the root's
//! `tests/offline/reconstruction.rs`.

mod crowded_corners;
mod silhouettes;
mod verdict;
