//! Finds where in a picture the object can be: within the volume's projection.

use crate::calibration::{Camera, Volume};
use crate::image::PixelRect;
use nalgebra::{Point2, Point3};

/// Pieces into which an edge of the volume is cut, because a distorting lens bends it.
const PIECES: usize = 8;

/// The volume's projection: a convex outline and its rectangle of pixels.
#[derive(Clone, Debug)]
pub(crate) struct Region {
    /// Pixels around the outline, within the picture.
    pub rect: PixelRect,
    /// Convex outline in pixels, turning from x to y; empty where the volume surrounds the camera and every
    /// pixel may be object.
    pub outline: Vec<Point2<f64>>,
    /// The picture's width and height.
    pub picture: (usize, usize),
}

impl Region {
    /// The columns from and to which row `y` is within the outline, or nearer than `margin_px` to it; the
    /// second is smaller than the first where none are.
    pub(super) fn columns(&self, y: f64, margin_px: f64) -> (f64, f64) {
        let n = self.outline.len();
        let mut columns = (f64::NEG_INFINITY, f64::INFINITY);
        for i in 0..n {
            let (a, b) = (self.outline[i], self.outline[(i + 1) % n]);
            let edge = b - a;
            // Inside is edge.x * (y - a.y) - edge.y * (x - a.x) >= -margin * |edge|.
            let free = edge.x * (y - a.y) + margin_px * edge.norm();
            if edge.y > 0.0 {
                columns.1 = columns.1.min(a.x + free / edge.y);
            } else if edge.y < 0.0 {
                columns.0 = columns.0.max(a.x + free / edge.y);
            } else if free < 0.0 {
                return (0.0, -1.0);
            }
        }
        columns
    }
}

/// The volume in a camera's picture; `None` where no pixel shows it.
pub(crate) fn project(camera: &Camera, volume: &Volume) -> Option<Region> {
    let picture = (camera.intrinsics.width, camera.intrinsics.height);
    let points = edge_points(volume);
    let projected: Option<Vec<_>> = points
        .iter()
        .map(|&p| camera.project(p).map(|(pixel, _)| pixel))
        .collect();
    // A volume that is wholly behind the camera is in no picture; one that the camera stands in, or that
    // passes it, may be anywhere.
    let Some(projected) = projected else {
        let ahead = points.iter().any(|&p| camera.camera_from_rig(p).z > 0.0);
        return ahead.then(|| Region {
            rect: PixelRect::whole(picture.0, picture.1),
            outline: Vec::new(),
            picture,
        });
    };
    let outline = convex_outline(projected);
    let rect = bounding_rect(&outline, picture)?;
    Some(Region {
        rect,
        outline,
        picture,
    })
}

fn edge_points(volume: &Volume) -> Vec<Point3<f64>> {
    let size = volume.max - volume.min;
    let at = |axis: usize, other: usize, t: f64| {
        let mut unit = nalgebra::Vector3::zeros();
        unit[axis] = t;
        unit[(axis + 1) % 3] = (other & 1) as f64;
        unit[(axis + 2) % 3] = (other >> 1) as f64;
        volume.min + size.component_mul(&unit)
    };
    let mut points = Vec::with_capacity(12 * (PIECES + 1));
    for axis in 0..3 {
        for other in 0..4 {
            points.extend((0..=PIECES).map(|i| at(axis, other, i as f64 / PIECES as f64)));
        }
    }
    points
}

/// Andrew's monotone chain.
fn convex_outline(mut points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let mut outline = half_outline(points.iter());
    outline.extend(half_outline(points.iter().rev()));
    outline
}

/// One side of the outline, without its last point, which the other side begins with.
fn half_outline<'a>(points: impl Iterator<Item = &'a Point2<f64>>) -> Vec<Point2<f64>> {
    let mut chain: Vec<Point2<f64>> = Vec::new();
    for &p in points {
        while let [.., a, b] = chain[..] {
            if (b - a).perp(&(p - a)) > 0.0 {
                break;
            }
            chain.pop();
        }
        chain.push(p);
    }
    chain.pop();
    chain
}

fn bounding_rect(outline: &[Point2<f64>], picture: (usize, usize)) -> Option<PixelRect> {
    let range = |coordinate: fn(&Point2<f64>) -> f64, size: usize| {
        let values = || outline.iter().map(coordinate);
        let low = values().fold(f64::INFINITY, f64::min);
        let high = values().fold(f64::NEG_INFINITY, f64::max);
        let first = low.floor().clamp(0.0, size as f64) as usize;
        let last = (high.ceil() + 1.0).clamp(0.0, size as f64) as usize;
        (first, last)
    };
    let (x0, x1) = range(|p| p.x, picture.0);
    let (y0, y1) = range(|p| p.y, picture.1);
    let rect = PixelRect { x0, y0, x1, y1 };
    (!rect.is_empty()).then_some(rect)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_is_convex_and_holds_its_points() {
        let square = [
            (0.0, 0.0),
            (4.0, 0.0),
            (2.0, 2.0),
            (4.0, 4.0),
            (0.0, 4.0),
            (2.0, 0.0),
        ];
        let outline = convex_outline(square.map(|(x, y)| Point2::new(x, y)).to_vec());
        assert_eq!(outline.len(), 4);
        let region = Region {
            rect: PixelRect::whole(5, 5),
            outline,
            picture: (5, 5),
        };
        assert_eq!(region.columns(2.0, 0.0), (0.0, 4.0));
        assert_eq!(region.columns(2.0, 0.5), (-0.5, 4.5));
        let (first, last) = region.columns(5.0, 0.5);
        assert!(last < first);
    }
}
