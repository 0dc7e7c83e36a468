//! Measures how well corners of noisy pictures fit: one camera's views of a board, with noise of several strengths.

use scand_core::calibration::fit::{Parameters, Session, SessionCamera, View, find_corners, fit};
use scand_core::frame::Picture;
use scand_core::image::Grid;
use scand_lab::{BoardOptions, BoardSession, Encoding, Options};
use std::path::Path;

/// Views that are compared.
const VIEWS: usize = 18;
/// Standard deviations of the noise in grey levels.
const NOISES: [f64; 3] = [2.0, 8.0, 16.0];

/// One camera of 640x480 pixels that sees a checkerboard, without noise.
fn rendered() -> BoardSession {
    let mut options = Options {
        width: 640,
        height: 480,
        cameras: 1,
        depth_cameras: 0,
        ..Options::for_boards()
    };
    options.color.encoding = Encoding::Mono;
    (options.color.full_well, options.color.blur_px) = (0.0, 0.9);
    options.color.distortion = false;
    let boards = BoardOptions {
        board: "checkerboard:9x6:25mm".to_owned(),
        placements: 60,
        ..BoardOptions::default()
    };
    BoardSession::new(options, boards).unwrap()
}

/// The first pictures in which the whole board is seen, with the indices of their placements.
fn pictures(session: &BoardSession) -> Vec<(usize, Grid<u8>)> {
    let lens = session.rig().colors[0].actual.intrinsics;
    let picture = |index: usize| {
        let capture = session.capture(index).unwrap();
        let frame = capture.frames.into_iter().next()?;
        let Picture::Raw { data, .. } = frame.picture else {
            panic!("pictures are rows of grey values")
        };
        let picture = Grid::from_pixels(lens.width, lens.height, data.to_vec());
        Some((index, picture))
    };
    let all = (0..session.placements().len()).filter_map(picture);
    all.filter(|(_, picture)| find_corners(picture, session.board()).is_ok())
        .take(VIEWS)
        .collect()
}

/// Normal noise that only looks random (SplitMix64, Box and Muller).
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }

    fn over(&mut self, picture: &Grid<u8>, deviation: f64) -> Grid<u8> {
        picture.map(|&grey| {
            let radius = (-2.0 * self.uniform().max(1e-12).ln()).sqrt();
            let normal = radius * (std::f64::consts::TAU * self.uniform()).cos();
            (f64::from(grey) + deviation * normal)
                .round()
                .clamp(0.0, 255.0) as u8
        })
    }
}

/// Root mean square residual, in pixels, of the fit to these pictures, and how many showed the board.
fn residual(rendered: &BoardSession, pictures: &[Grid<u8>]) -> (f64, usize) {
    let camera = &rendered.rig().colors[0].actual;
    let found = pictures.iter().enumerate();
    let view = |(placement, picture): (usize, &Grid<u8>)| {
        let (face, corners) = find_corners(picture, rendered.board()).ok()?;
        Some(View {
            camera: 0,
            placement,
            face,
            corners,
        })
    };
    let views: Vec<View> = found.filter_map(view).collect();
    let seen = views.len();
    let session = Session {
        board: *rendered.board(),
        cameras: vec![SessionCamera {
            id: camera.id.clone(),
            size: [camera.intrinsics.width, camera.intrinsics.height],
            known: None,
            start: None,
        }],
        placements: (0..pictures.len()).map(|k| format!("p{k:02}")).collect(),
        views,
    };
    let found = fit(&session, &Parameters::default()).unwrap();
    (found.figures.rms_px, seen)
}

/// Writes pictures as PGM files, for other detectors, and beside each where its corners are.
fn write(folder: &Path, rendered: &BoardSession, pictures: &[(usize, Grid<u8>)]) {
    std::fs::create_dir_all(folder).unwrap();
    for (index, picture) in pictures {
        let head = format!("P5\n{} {}\n255\n", picture.width(), picture.height());
        let bytes = [head.as_bytes(), picture.pixels()].concat();
        std::fs::write(folder.join(format!("{index:02}.pgm")), bytes).unwrap();
        let camera = &rendered.rig().colors[0].actual;
        let rig_from_board = rendered.placements()[*index].rig_from_board;
        let corners = rendered.board().corner_positions().into_iter();
        let pixels = corners.map(|p| camera.project(rig_from_board * p).unwrap().0);
        let lines: String = pixels.map(|p| format!("{} {}\n", p.x, p.y)).collect();
        std::fs::write(folder.join(format!("{index:02}.txt")), lines).unwrap();
    }
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn residuals_grow_with_the_noise_and_no_faster() {
        let rendered = rendered();
        let clean = pictures(&rendered);
        assert_eq!(clean.len(), VIEWS);
        let residuals = NOISES.map(|noise| {
            let mut random = Noise(1);
            let noisy = clean.iter().map(|(k, p)| (*k, random.over(p, noise)));
            let noisy: Vec<(usize, Grid<u8>)> = noisy.collect();
            if let Some(folder) = std::env::var_os("SCAND_PICTURES") {
                let folder = Path::new(&folder).join(format!("noise-{noise}"));
                write(&folder, &rendered, &noisy);
            }
            let noisy: Vec<Grid<u8>> = noisy.into_iter().map(|(_, p)| p).collect();
            let (rms, seen) = residual(&rendered, &noisy);
            println!("noise {noise}: rms {rms:.3} px, {seen} of {VIEWS} views");
            rms
        });
        assert!(residuals[0] < 0.05, "{residuals:?}");
        assert!(residuals[2] < 1.3 * 8.0 * residuals[0], "{residuals:?}");
    }
}
