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
    let all = with_front_seen(bundle);
    let below = |p: usize| below(bundle, board, &all, p);
    // A board on a table is known to some tenths of a millimetre; 2 mm is the same height.
    let rank = |p: usize| {
        let fewer = usize::MAX - front_views(bundle, p);
        ((below(p) / 0.002).floor() as u64, fewer, p)
    };
    let best = all.iter().copied().min_by_key(|&p| rank(p))?;
    Some((best, below(best)))
}

/// The placements of which a camera saw the front: only these have a camera above them, so that z can point up.
pub(super) fn with_front_seen(bundle: &Bundle) -> Vec<usize> {
    let all = 0..bundle.placements.len();
    all.filter(|&p| front_views(bundle, p) > 0).collect()
}

fn front_views(bundle: &Bundle, placement: usize) -> usize {
    let views = bundle.views.iter();
    let fronts = views.filter(|v| v.placement == placement && !v.back);
    fronts.count()
}

/// By how many metres a camera, or the board at one of `others`, lies below a placement.
pub(super) fn below(bundle: &Bundle, board: &Board, others: &[usize], placement: usize) -> f64 {
    let rig_from_board = bundle.placements[placement].rig_from_board;
    let table_from_rig = rig_from_table() * rig_from_board.inverse();
    let corners = others.iter().flat_map(|&other| {
        outermost(board).map(|corner| bundle.placements[other].rig_from_board * corner)
    });
    let cameras = bundle
        .cameras
        .iter()
        .map(|c| c.camera_from_rig.inverse().translation.vector.into());
    let lowest = |z: f64, point: nalgebra::Point3<f64>| z.min((table_from_rig * point).z);
    -corners.chain(cameras).fold(0.0, lowest)
}
