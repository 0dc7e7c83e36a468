//! A look at pictures of a square object before a backdrop, whose highlights, edges and outline are known.

use super::*;
use crate::frame::CameraId;
use nalgebra::{Isometry3, Point3};

/// 1280 x 960 pixels, seen from 1 m before the volume: 1 mm is 1.28 pixels there.
const SIZE: [usize; 2] = [1280, 960];

fn backdrop() -> RgbImage {
    // Not even, as no backdrop is.
    RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let grain = ((x * 7919 + y * 104_729) % 5) as u8;
        [40 + grain, 160 + grain, 60 + grain]
    })
}

fn with_object(part: PixelRect, blur: usize) -> RgbImage {
    let mut picture = backdrop();
    for y in 0..SIZE[1] {
        let row = picture.row_mut(y);
        for (x, pixel) in row.iter_mut().enumerate() {
            let outside = |v: usize, from: usize, to: usize| {
                from.saturating_sub(v).max((v + 1).saturating_sub(to))
            };
            let away = outside(x, part.x0, part.x1).max(outside(y, part.y0, part.y1));
            if away <= blur {
                let share = 1.0 - away as f32 / (blur + 1) as f32;
                let mix = |from: u8, to: f32| {
                    (f32::from(from) * (1.0 - share) + to * share).round() as u8
                };
                *pixel = [
                    mix(pixel[0], 240.0),
                    mix(pixel[1], 230.0),
                    mix(pixel[2], 220.0),
                ];
            }
        }
    }
    picture
}

fn cutting() -> Segmentation {
    let lens = Intrinsics::new(
        SIZE[0],
        SIZE[1],
        Vector2::new(1280.0, 1280.0),
        Vector2::new(639.5, 479.5),
        crate::calibration::Distortion::from_model("", &[]).unwrap(),
    );
    let pose = Isometry3::translation(0.0, 0.0, -1.0);
    Segmentation {
        camera: Camera::new(CameraId::new("c00").unwrap(), lens.unwrap(), pose),
        volume: Volume::new(Point3::new(-0.6, -0.6, -0.05), Point3::new(0.6, 0.6, 0.05)).unwrap(),
        background: backdrop(),
        parameters: silhouette::Parameters::default(),
    }
}

const MIDDLE: PixelRect = PixelRect {
    x0: 400,
    y0: 300,
    x1: 800,
    y1: 700,
};

#[test]
fn the_outline_is_where_the_object_is() {
    let look = color(&with_object(MIDDLE, 0), Ok(&cutting()));
    assert_eq!(
        (look.picture.width(), look.picture.height(), look.scale),
        (640, 480, 2)
    );
    let outline = look.outline.unwrap();
    assert!(outline.touches.is_empty(), "{:?}", outline.touches);
    let points = &outline.polygons[0];
    let ends = |axis: usize| {
        let values = points.iter().map(|point| point[axis]);
        (values.clone().min().unwrap(), values.max().unwrap())
    };
    let near = |(low, high): (u16, u16), from: u16, to: u16| {
        low.abs_diff(from) <= 2 && high.abs_diff(to) <= 2
    };
    assert!(
        near(ends(0), 200, 400) && near(ends(1), 150, 350),
        "{points:?}"
    );
}

#[test]
fn a_binned_picture_has_the_outline_of_a_whole_one() {
    let whole = with_object(MIDDLE, 0);
    let look = binned(&reduced(&whole, 2), 2, Ok(&cutting()));
    assert_eq!((look.picture.width(), look.scale), (640, 2));
    let of_whole = color(&whole, Ok(&cutting()));
    assert_eq!(look.picture, of_whole.picture);
    assert_eq!(look.outline.unwrap(), of_whole.outline.unwrap());
}

#[test]
fn an_object_that_the_frame_cuts_is_told_with_the_sides() {
    let part = PixelRect {
        x0: 0,
        y1: 960,
        ..MIDDLE
    };
    let look = color(&with_object(part, 0), Ok(&cutting()));
    assert_eq!(look.outline.unwrap().touches, ["left", "bottom"]);
}

#[test]
fn without_an_object_or_what_it_takes_the_reason_is_told() {
    let empty = color(&backdrop(), Ok(&cutting())).outline.unwrap_err();
    assert!(empty.contains("no object is found"), "{empty}");
    let none = color(&backdrop(), Err("no background pictures".into()));
    assert_eq!(none.outline.unwrap_err(), "no background pictures");
    let other = Segmentation {
        background: RgbImage::filled(640, 480, [0; 3]),
        ..cutting()
    };
    let other = color(&backdrop(), Ok(&other)).outline.unwrap_err();
    assert!(other.contains("640x480"), "{other}");
}

#[test]
fn clipped_highlights_are_counted_and_outlined() {
    let mut picture = backdrop();
    for y in 100..200 {
        picture.row_mut(y)[300..400].fill([255, 200, 200]);
    }
    // A single pixel counts, and is too small to be outlined.
    picture.row_mut(900)[900] = [0, 0, 254];
    let look = color(&picture, Err(String::new()));
    assert_eq!(
        look.clipped_ppm,
        (10_001_u64 * 1_000_000 / (1280 * 960)) as u32
    );
    assert_eq!(
        look.clipped,
        [[[150, 50], [200, 50], [200, 100], [150, 100]]]
    );
    assert_eq!(color(&backdrop(), Err(String::new())).clipped_ppm, 0);
}

#[test]
fn edges_that_are_less_sharp_have_a_lower_figure_and_few_have_none() {
    let of = |blur| {
        color(&with_object(MIDDLE, blur), Ok(&cutting()))
            .sharpness_percent
            .unwrap()
    };
    let all: Vec<u32> = [0, 1, 2, 4, 8].into_iter().map(of).collect();
    assert!(all[0] >= 95, "{all:?}");
    assert!(all.is_sorted_by(|a, b| a > b), "{all:?}");
    assert!(all[4] <= 5, "{all:?}");
    assert_eq!(
        color(&backdrop(), Err(String::new())).sharpness_percent,
        None
    );
}

#[test]
fn a_depth_picture_shows_near_bright_and_tells_how_much_is_there() {
    let readings = Grid::from_fn(640, 480, |x, _| match x {
        0..320 => 0,
        320..480 => 600,
        _ => 900,
    });
    let (picture, percent) = depth(&readings);
    assert_eq!(percent, 50);
    let grey = |x: usize| picture.row(10)[x][0];
    assert!(grey(10) == 0 && grey(400) > grey(600) && grey(600) > 0);
    assert_eq!(depth(&Grid::filled(8, 8, 0)).1, 0);
}

#[test]
fn contours_of_rings_and_corners_are_closed() {
    let mask = Mask::from_fn(8, 8, |x, y| {
        let ring = (1..6).contains(&x) && (1..6).contains(&y) && !(x == 3 && y == 3);
        // Touches the ring at a corner.
        if ring || (x == 6 && y == 6) { 255 } else { 0 }
    });
    let found = contours(&mask);
    let points: usize = found.iter().map(Vec::len).sum();
    assert_eq!(points, 4 + 4 + 4, "{found:?}");
    assert!(contours(&Mask::filled(8, 8, 0)).is_empty());
    assert_eq!(
        contours(&Mask::filled(3, 2, 255)),
        [[[0, 0], [3, 0], [3, 2], [0, 2]]]
    );
    // A chequered mask has more corners than are kept.
    let many = contours(&Mask::from_fn(200, 200, |x, y| {
        if (x + y) % 2 == 0 { 255 } else { 0 }
    }));
    assert!(many.iter().map(Vec::len).sum::<usize>() <= 4000);
}
