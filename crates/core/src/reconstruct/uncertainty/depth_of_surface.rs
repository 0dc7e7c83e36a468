//! Computes how deep the true surface is expected to lie beneath a point of the hull's surface, from the viewing edge
//! through that point.

use super::touch::{End, ViewingEdge};

/// If no edge of the object shows where it touches: the share of what is expected if it touched at an end.
const TOUCH_AT_END: f64 = 0.33;

/// The expected depth in metres. `design/surface.md` has the reasoning and what it was measured on.
pub(super) fn expected(edge: &ViewingEdge) -> f64 {
    let [near, far] = &edge.ends;
    // The object touches the far end, and the hull's wedge between that and the near end's other side stands off.
    let if_far = wedge(far, near);
    let if_near = wedge(near, far);
    match (near.is_certain, far.is_certain) {
        (true, false) => if_near,
        (false, true) => if_far,
        (true, true) => 0.5 * (if_near + if_far),
        (false, false) => round(near, far).max(TOUCH_AT_END * if_near.max(if_far)),
    }
}

/// Half the most that the surface may be beneath the point if it touches one end: it runs between the viewing edge and
/// the plane that bounds the hull at the other end.
fn wedge(touched: &End, other: &End) -> f64 {
    0.5 * touched.distance * other.turn
}

/// The mean depth of an evenly curved surface that touches anywhere on the edge, each place being as likely.
fn round(near: &End, far: &End) -> f64 {
    let length = near.distance + far.distance;
    if length <= 0.0 {
        return 0.0;
    }
    let from_middle = near.distance / length - 0.5;
    0.25 * length * (near.turn + far.turn) * (1.0 / 12.0 + from_middle * from_middle)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge(near: (f64, bool), far: (f64, bool)) -> ViewingEdge {
        let end = |(distance, is_certain)| End {
            distance,
            turn: 0.2,
            is_certain,
        };
        ViewingEdge {
            ends: [end(near), end(far)],
        }
    }

    #[test]
    fn a_flat_side_is_as_deep_as_its_wedge_and_not_where_it_touches() {
        let at = |near, far| expected(&edge((near, false), (far, true)));
        assert!((at(0.0, 0.04) - 0.5 * 0.2 * 0.04).abs() < 1e-12);
        assert_eq!(at(0.04, 0.0), 0.0);
        assert!(at(0.01, 0.03) > at(0.03, 0.01));
    }

    #[test]
    fn of_a_ball_it_is_what_two_touching_cones_leave() {
        // Circle of radius 1 between tangents at an angle of 0.2: the corner stands off by 1 / cos(0.1) - 1, and the
        // mean over all places of the touch is larger by a third at the corner.
        let length = 2.0 * f64::tan(0.1);
        let at_corner = round(
            &edge((0.0, false), (0.0, false)).ends[0],
            &edge((0.0, false), (length, false)).ends[1],
        );
        let off = 1.0 / f64::cos(0.1) - 1.0;
        assert!(
            (at_corner / off - 4.0 / 3.0).abs() < 0.02,
            "{at_corner} {off}"
        );
        // What is not known is stated larger, never smaller.
        let unknown = expected(&edge((0.0, false), (length, false)));
        assert!(unknown >= at_corner);
    }
}
