//! `scand simulate`: writes a recording of an object of known shape, or of a calibration board.

mod board;
mod poses;
mod serve;

use super::{check_folder_of, refuse_to_replace, wrong_usage};
use crate::range::{metres, millimetres};
use crate::recording::Compression;
use crate::storage::write_atomically;
use crate::words::count;
use anyhow::Context;
use scand_lab::{
    CameraFault, DepthSensor, Encoding, Options, Preset, Response, Shape, Simulation, ply,
    poses_json, write,
};
use std::path::PathBuf;
use std::process::ExitCode;

/// Render a rig of cameras around a known object into a recording, with the sensors' noise and any faults.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand simulate --shape cup -o cup.mcap --truth cup.ply
  scand simulate --shape mug --turned c03=2 -o moved.mcap
  scand simulate --calibration-session -o session.mcap")]
pub struct Args {
    /// The object; for a calibration session, the object that the rig is built around.
    #[arg(long, value_enum, required_unless_present_any = ["preset", "calibration_session", "serve"])]
    shape: Option<Shape>,
    /// Start from one of the named cases; other options change it.
    #[arg(long, value_enum)]
    preset: Option<Preset>,
    /// The recording to write; the file must not exist yet.
    #[arg(
        short,
        long,
        value_name = "FILE.mcap",
        required_unless_present = "serve"
    )]
    out: Option<PathBuf>,
    /// Write the object's true surface into this file; for a calibration session, the true calibration.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Replace existing files of the truth; a recording is never replaced.
    #[arg(short, long)]
    force: bool,
    /// The seed of all random numbers.
    #[arg(long)]
    seed: Option<u64>,
    /// Number of captures, at least 1.
    #[arg(long)]
    captures: Option<usize>,
    /// Length of the edges of the truth's triangles; a plain number counts millimetres.
    #[arg(long, value_name = "LENGTH", value_parser = millimetres)]
    spacing_mm: Option<f64>,
    /// Give the object a pattern.
    #[arg(long)]
    textured: bool,
    /// Paint rings around the object instead of a pattern.
    #[arg(long, conflicts_with = "textured")]
    rings: bool,
    /// Write exact masks instead of backgrounds.
    #[arg(long)]
    masks: bool,
    /// Compress the recording with zstd.
    #[arg(long)]
    zstd: bool,
    #[command(flatten)]
    color: ColorArgs,
    #[command(flatten)]
    depth: DepthArgs,
    #[command(flatten)]
    poses: poses::PoseArgs,
    #[command(flatten)]
    faults: FaultArgs,
    #[command(flatten)]
    board: board::BoardArgs,
    #[command(flatten)]
    serve: serve::ServeArgs,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Colour cameras")]
struct ColorArgs {
    /// Number of colour cameras, 2 to 99, or 1 for a calibration session.
    #[arg(long)]
    cameras: Option<usize>,
    /// How many of them stand in the low ring, by default 7 of 11; the others look down from 46 degrees.
    #[arg(long, value_name = "N")]
    low_cameras: Option<usize>,
    /// Size of their pictures; the field of view stays the same.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<(usize, usize)>,
    /// How pictures are encoded.
    #[arg(long, value_enum)]
    encoding: Option<Encoding>,
    /// JPEG quality, 1 to 100.
    #[arg(long, value_name = "Q")]
    jpeg_quality: Option<u8>,
    /// Electrons at full scale; 0 makes pictures without noise.
    #[arg(long, value_name = "ELECTRONS")]
    full_well: Option<f64>,
    /// Read noise.
    #[arg(long, value_name = "ELECTRONS")]
    read_noise: Option<f64>,
    /// Standard deviation of the point spread function.
    #[arg(long, value_name = "PX")]
    blur_px: Option<f64>,
    /// Standard deviation of the exposure's drift since the background was taken, relative to the exposure.
    #[arg(long, value_name = "PART")]
    exposure_drift: Option<f64>,
    /// How strongly the object darkens the table, 0 to 1.
    #[arg(long, value_name = "PART")]
    shadows: Option<f64>,
    /// How much of the backdrop's colour the object reflects, 0 to 1.
    #[arg(long, value_name = "PART")]
    spill: Option<f64>,
    /// Use lenses without distortion.
    #[arg(long)]
    no_distortion: bool,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Depth cameras")]
struct DepthArgs {
    /// Number of depth cameras.
    #[arg(long)]
    depth_cameras: Option<usize>,
    /// Angle between the first depth camera's view and straight down: 0 to 85, or to 50 with several depth cameras, of
    /// which the others look at 35 degrees more.
    #[arg(long, value_name = "DEGREES")]
    depth_slant_deg: Option<f64>,
    /// Distance from a depth camera to the object.
    #[arg(long, value_name = "LENGTH", value_parser = distance)]
    depth_distance: Option<f64>,
    /// Depth frames of a capture.
    #[arg(long, value_name = "N")]
    depth_frames: Option<usize>,
    /// Make readings without noise, steps, holes or smear.
    #[arg(long)]
    depth_perfect: bool,
    /// Noise that differs in each frame, in steps of the disparity.
    #[arg(long, value_name = "STEPS")]
    depth_noise_steps: Option<f64>,
    /// The fixed pattern, in steps of the disparity.
    #[arg(long, value_name = "STEPS")]
    depth_pattern_steps: Option<f64>,
    /// Make readings too deep by this, without recording it; a plain number counts millimetres.
    #[arg(long, value_name = "LENGTH", value_parser = millimetres, allow_negative_numbers = true)]
    depth_bias_mm: Option<f64>,
    /// Make readings of the object deeper by this, as some materials do; a plain number counts millimetres.
    #[arg(long, value_name = "LENGTH", value_parser = millimetres, allow_negative_numbers = true)]
    depth_object_bias_mm: Option<f64>,
    /// Displace the depth against its calibration.
    #[arg(long, value_name = "PX")]
    misregistration_px: Option<f64>,
    /// How the sensor responds, and whether the recording has its response.
    #[arg(long, value_enum)]
    depth_response: Option<Response>,
    /// Number of depth frames for each colour picture.
    #[arg(long, value_name = "N")]
    depth_color_every: Option<usize>,
    /// Encode the depth camera's colour as JPEG of this quality, 1 to 100.
    #[arg(long, value_name = "Q")]
    depth_color_jpeg: Option<u8>,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Faults")]
struct FaultArgs {
    /// Turn a colour camera by this many degrees after its calibration.
    #[arg(long, value_name = "ID=DEGREES", value_parser = parse_fault)]
    turned: Vec<CameraFault>,
    /// Let the left edge of a colour camera's picture cut off this part (0 to 1) of the object.
    #[arg(long, value_name = "ID=PART", value_parser = parse_fault)]
    cut_off: Vec<CameraFault>,
    /// Put a colour camera out of focus.
    #[arg(long, value_name = "ID=PX", value_parser = parse_fault)]
    blurred: Vec<CameraFault>,
    /// Let a colour camera expose for too long.
    #[arg(long, value_name = "ID=STOPS", value_parser = parse_fault)]
    overexposed: Vec<CameraFault>,
    /// Let a camera's frames arrive late.
    #[arg(long, value_name = "ID=MS", value_parser = parse_fault)]
    late: Vec<CameraFault>,
    /// Let a camera deliver no frames.
    #[arg(long, value_name = "ID")]
    missing: Vec<String>,
    /// Leave out the background of a colour camera.
    #[arg(long, value_name = "ID")]
    no_background: Vec<String>,
    /// Leave the table empty.
    #[arg(long)]
    empty_table: bool,
    /// Leave the depth frames without readings.
    #[arg(long)]
    no_depth: bool,
    /// Record that the calibration was judged doubtful, for this reason.
    #[arg(long, value_name = "REASON")]
    doubtful_calibration: Option<String>,
}

fn parse_size(text: &str) -> Result<(usize, usize), String> {
    let expected = || format!("{text:?} is not WIDTHxHEIGHT, such as 1280x960");
    let (width, height) = text.split_once('x').ok_or_else(expected)?;
    let side = |side: &str| side.parse().map_err(|_| expected());
    Ok((side(width)?, side(height)?))
}

fn distance(text: &str) -> Result<f64, String> {
    metres(text).ok_or_else(|| "expected a length, such as 800mm or a number of metres".into())
}

fn parse_fault(text: &str) -> Result<CameraFault, String> {
    let expected = || format!("{text:?} is not CAMERA=AMOUNT, such as c03=1.5");
    let (camera, amount) = text.split_once('=').ok_or_else(expected)?;
    Ok(CameraFault {
        camera: camera.to_owned(),
        amount: amount.parse().map_err(|_| expected())?,
    })
}

/// Simulates and writes.
///
/// # Errors
/// Where an option cannot be met, or a file cannot be written or already exists.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    if let Some(recording) = args.serve.serve.clone() {
        return serve::run(&recording, args.serve);
    }
    let truth = args.truth.clone();
    refuse_to_replace("--truth", truth.as_deref(), args.force)?;
    let out = args.out.clone().context("--out is missing")?;
    anyhow::ensure!(
        out.symlink_metadata().is_err(),
        "{} already exists, and a recording is never replaced: give another --out",
        out.display()
    );
    check_folder_of(&out).context("nothing was rendered: give another file with --out")?;
    for (option, file) in [
        ("--truth", &truth),
        ("--poses-truth", &args.poses.poses_truth),
    ] {
        if let Some(file) = file {
            check_folder_of(file).with_context(|| {
                format!("nothing was rendered: give another file with {option}")
            })?;
        }
    }
    let compression = match args.zstd {
        true => Compression::Zstd,
        false => Compression::None,
    };
    if args.board.calibration_session {
        args.board.refuse_to_replace(args.force)?;
        let (options, boards) = options(args);
        return board::run(options, boards, &out, truth.as_deref(), compression);
    }
    let poses_truth = args.poses.poses_truth.clone();
    refuse_to_replace("--poses-truth", poses_truth.as_deref(), args.force)?;
    let simulation = Simulation::new(options(args).0).map_err(wrong_usage)?;
    write(&simulation, &out, compression).with_context(|| {
        format!(
            "cannot write \
        {}",
            out.display()
        )
    })?;
    outln!(
        "{}: {}",
        out.display(),
        count(simulation.options().captures, "capture")
    );
    if let Some(truth) = truth {
        write_atomically(&truth, &ply(simulation.truth()))?;
        let triangles = simulation.truth().triangles.len();
        outln!("{}: {triangles} triangles", truth.display());
    }
    if let Some(path) = poses_truth {
        write_atomically(&path, &serde_json::to_vec_pretty(&poses_json(&simulation))?)?;
        let count = simulation.options().captures;
        outln!("{}: {count} poses", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// Takes what was given.
fn take<T>(place: &mut T, given: Option<T>) {
    if let Some(value) = given {
        *place = value;
    }
}

fn options(args: Args) -> (Options, board::BoardArgs) {
    let mut options = match args.preset {
        _ if args.board.calibration_session => Options::for_boards(),
        Some(preset) => preset.options(),
        None => Options::default(),
    };
    take(&mut options.shape, args.shape);
    take(&mut options.seed, args.seed);
    take(&mut options.captures, args.captures);
    take(&mut options.spacing_mm, args.spacing_mm);
    options.textured |= args.textured;
    options.rings |= args.rings;
    options.masks |= args.masks;
    take_color(&mut options, args.color);
    take_depth(&mut options, args.depth);
    args.poses.take_into(&mut options);
    let faults = &mut options.faults;
    faults.turned_deg.extend(args.faults.turned);
    faults.cut_off.extend(args.faults.cut_off);
    faults.blurred_px.extend(args.faults.blurred);
    faults.overexposed_stops.extend(args.faults.overexposed);
    faults.late_ms.extend(args.faults.late);
    faults.missing.extend(args.faults.missing);
    faults.no_background.extend(args.faults.no_background);
    faults.empty_table |= args.faults.empty_table;
    faults.no_depth |= args.faults.no_depth;
    faults.doubtful_calibration = args.faults.doubtful_calibration;
    (options, args.board)
}

fn take_color(options: &mut Options, args: ColorArgs) {
    take(&mut options.cameras, args.cameras);
    options.low_cameras = args.low_cameras.or(options.low_cameras);
    if let Some((width, height)) = args.size {
        (options.width, options.height) = (width, height);
    }
    let color = &mut options.color;
    take(&mut color.encoding, args.encoding);
    take(&mut color.jpeg_quality, args.jpeg_quality);
    take(&mut color.full_well, args.full_well);
    take(&mut color.read_noise, args.read_noise);
    take(&mut color.blur_px, args.blur_px);
    take(&mut color.exposure_drift, args.exposure_drift);
    take(&mut color.shadows, args.shadows);
    take(&mut color.spill, args.spill);
    color.distortion &= !args.no_distortion;
}

fn take_depth(options: &mut Options, args: DepthArgs) {
    take(&mut options.depth_cameras, args.depth_cameras);
    take(&mut options.depth_slant_deg, args.depth_slant_deg);
    take(&mut options.depth_distance, args.depth_distance);
    let depth = &mut options.depth;
    if args.depth_perfect {
        let DepthSensor {
            noise_steps,
            pattern_steps,
            quantized,
            holes,
            smear_px,
            ..
        } = DepthSensor::perfect();
        *depth = DepthSensor {
            noise_steps,
            pattern_steps,
            quantized,
            holes,
            smear_px,
            ..depth.clone()
        };
    }
    take(&mut depth.frames, args.depth_frames);
    take(&mut depth.noise_steps, args.depth_noise_steps);
    take(&mut depth.pattern_steps, args.depth_pattern_steps);
    take(&mut depth.bias_mm, args.depth_bias_mm);
    take(&mut depth.object_bias_mm, args.depth_object_bias_mm);
    take(&mut depth.misregistration_px, args.misregistration_px);
    take(&mut depth.response, args.depth_response);
    take(&mut depth.color_every, args.depth_color_every);
    take(&mut depth.color_jpeg_quality, args.depth_color_jpeg);
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Call {
        #[command(flatten)]
        args: Args,
    }

    fn depth_of(line: &str) -> DepthSensor {
        let call = ["simulate", "--out", "a.mcap"].into_iter();
        let call = Call::parse_from(call.chain(line.split(' ')));
        options(call.args).0.depth
    }

    #[test]
    fn perfect_readings_keep_all_that_is_no_noise() {
        let expected = DepthSensor {
            noise_steps: 0.0,
            pattern_steps: 0.0,
            quantized: false,
            holes: false,
            smear_px: 0.0,
            ..depth_of("--preset ball")
        };
        assert!(expected.bias_mm > 0.0 && expected.misregistration_px > 0.0);
        assert_eq!(depth_of("--preset ball --depth-perfect"), expected);
        let written = depth_of("--preset written-response --depth-perfect");
        assert_eq!(written.response, Response::Written);
    }
}
