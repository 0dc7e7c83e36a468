//! Chooses the rig's frame: on the placement that lies flat on the table, with z up.

use super::adjust::Bundle;
use super::session::outermost;
use crate::calibration::Board;
use nalgebra::{Isometry3, Vector3};

/// The rig's frame from that of a board that lies flat with its front up: the same origin and x, but z up.
pub(super) fn rig_from_table() -> Isometry3<f64> {
    Isometry3::rotation(Vector3::x() * std::f64::consts::PI)
}

/// The placement that suits best as the table: nothing that was seen of the board lies below it, and the cameras are
/// above it; of several, the one that most cameras see. With it, by how many metres something lies below.
pub(super) fn lowest_placement(bundle: &Bundle, board: &Board) -> Option<(usize, f64)> {
    let used = |p: usize| {
        bundle
            .views
            .iter()
            .filter(|v| v.placement == p && !v.back)
            .count()
    };
    let all: Vec<usize> = (0..bundle.placements.len())
        .filter(|&p| used(p) > 0)
        .collect();
    let below = |p: usize| {
        let table_from_rig = rig_from_table() * bundle.placements[p].rig_from_board.inverse();
        let corners = all.iter().flat_map(|&other| {
            outermost(board).map(|corner| bundle.placements[other].rig_from_board * corner)
        });
        let cameras = bundle
            .cameras
            .iter()
            .map(|c| c.camera_from_rig.inverse().translation.vector.into());
        let lowest = |z: f64, point: nalgebra::Point3<f64>| z.min((table_from_rig * point).z);
        -corners.chain(cameras).fold(0.0, lowest)
    };
    // A board on a table is known to some tenths of a millimetre; 2 mm is the same height.
    let rank = |p: usize| ((below(p) / 0.002).floor() as u64, usize::MAX - used(p), p);
    let best = all.iter().copied().min_by_key(|&p| rank(p))?;
    Some((best, below(best)))
}
