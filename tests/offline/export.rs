//! `scand export`: models in other programs' formats, captures as datasets, and the messages for what cannot be
//! exported.

use assert_cmd::Command;
use nalgebra::{Isometry3, Point2, Point3, Quaternion, Translation3, UnitQuaternion};
use scand::capture::CaptureSession;
use scand::evaluate::load::{load, load_unwelded};
use scand::export::read;
use scand::frame::CaptureId;
use scand::mesh::{bounding_box, check, volume_and_total_area};
use std::path::{Path, PathBuf};
use std::process::Output;

struct Home(tempfile::TempDir);

impl Home {
    /// A recording of a ball, seen by lenses that distort, and its model.
    fn new() -> Self {
        let home = Self(tempfile::tempdir().unwrap());
        #[rustfmt::skip]
        home.done(&[
            "simulate", "--shape", "ball", "--cameras", "5", "--size", "320x240", "--masks", "--depth-cameras", "0",
            "--out", "ball.mcap",
        ]);
        #[rustfmt::skip]
        home.done(&["replay", "ball.mcap", "--set", "hull.resolution=40", "-q"]);
        home
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, line: &str) -> Output {
        let mut command = Command::cargo_bin("scand").unwrap();
        command
            .current_dir(self.0.path())
            .args(line.split(' '))
            .output()
            .unwrap()
    }

    fn done(&self, arguments: &[&str]) -> String {
        let output = self.run(&arguments.join(" "));
        assert!(output.status.success(), "{arguments:?}: {output:?}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    /// Runs a command line and holds its exit code and what it says.
    fn hold(&self, line: &str, code: i32, words: &[&str]) {
        let output = self.run(line);
        let said = String::from_utf8_lossy(&output.stdout).into_owned()
            + &String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{line}: {said}");
        for word in words {
            assert!(said.contains(word), "{line}: {word:?} is not in: {said}");
        }
    }
}

/// The corners of the triangles of a binary STL.
fn stl_corners(bytes: &[u8]) -> Vec<[Point3<f64>; 3]> {
    let float = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
    let point = |at: usize| Point3::new(float(at), float(at + 4), float(at + 8));
    (0..(bytes.len() - 84) / 50)
        .map(|t| [1, 2, 3].map(|corner| point(84 + 50 * t + 12 * corner)))
        .collect()
}

#[test]
fn a_model_goes_into_every_format_with_the_units_that_it_has_there() {
    let home = Home::new();
    let model = home.path("out/ball/ball-000/model.glb");
    let truth = load(&model).unwrap().mesh;
    let [low, high] = bounding_box(&truth.vertices).unwrap();
    for format in ["obj", "stl", "3mf", "usdz", "glb"] {
        let told = home.done(&["export", "out/ball/ball-000", "--format", format]);
        assert!(
            told.contains(&format!("export/ball-000.{format}: ")),
            "{told}"
        );
    }
    let stl = std::fs::read(home.path("export/ball-000.stl")).unwrap();
    let corners = stl_corners(&stl);
    assert_eq!(corners.len(), truth.triangles.len());
    let volume: f64 = corners
        .iter()
        .map(|[a, b, c]| a.coords.dot(&b.coords.cross(&c.coords)) / 6.0)
        .sum();
    let expected = volume_and_total_area(&truth).0 * 1e9;
    assert!(
        (volume / expected - 1.0).abs() < 1e-3,
        "{volume} mm3, {expected} mm3"
    );
    let top = corners
        .iter()
        .flatten()
        .map(|p| p.z)
        .fold(f64::MIN, f64::max);
    assert!(
        (top - f64::from(high.z) * 1e3).abs() < 1e-3,
        "z is up, in millimetres"
    );
    let obj = std::fs::read_to_string(home.path("export/ball-000.obj")).unwrap();
    let heights = obj
        .lines()
        .filter_map(|l| l.strip_prefix("v ")?.split(' ').nth(1)?.parse::<f32>().ok());
    let [bottom, top] = [f32::min, f32::max].map(|f| heights.clone().reduce(f).unwrap());
    assert!(
        (bottom - low.z).abs() < 1e-6 && (top - high.z).abs() < 1e-6,
        "y is up, in metres"
    );
    assert!(
        home.path("export/ball-000.png").is_file() && home.path("export/ball-000.mtl").is_file()
    );
    assert!(
        std::fs::read(home.path("export/ball-000.glb")).unwrap() == std::fs::read(&model).unwrap()
    );
    // The same again makes the same bytes.
    for format in ["3mf", "usdz"] {
        home.done(&["export", "out", "--format", format, "-o", "again"]);
        let [one, two] = ["export", "again"]
            .map(|f| std::fs::read(home.path(&format!("{f}/ball-000.{format}"))).unwrap());
        assert!(one == two, "{format}");
    }
}

#[test]
fn a_level_of_detail_is_a_solid_near_the_model_and_a_compressed_one_is_smaller() {
    let home = Home::new();
    home.done(&["export", "out", "--format", "glb", "--lod", "1"]);
    let [whole, less] =
        ["out/ball/ball-000/model.glb", "export/ball-000-lod1.glb"].map(|p| home.path(p));
    let [whole_mesh, less_mesh] = [&whole, &less].map(|p| load(p).unwrap().mesh);
    let [whole_report, less_report] = [&whole_mesh, &less_mesh].map(check);
    assert!(less_report.is_watertight());
    let quarter = whole_report.vertices / 4;
    assert!(
        less_report.vertices.abs_diff(quarter) < quarter / 10 + 2,
        "{}",
        less_report.vertices
    );
    assert!((less_report.volume / whole_report.volume - 1.0).abs() < 0.01);
    // A vertex on a seam of the texture stands in the file more than once.
    let stored = load_unwelded(&std::fs::read(&less).unwrap(), &less).unwrap();
    let stored = stored.mesh.vertices.len();
    assert!(stored < 2 * less_report.vertices, "{stored}");
    home.done(&[
        "export",
        "out",
        "--format",
        "glb",
        "--compress",
        "-o",
        "small",
    ]);
    let size = |path: &PathBuf| std::fs::metadata(path).unwrap().len();
    let small = home.path("small/ball-000.glb");
    assert!(size(&small) < size(&whole));
    let small_report = check(&load(&small).unwrap().mesh);
    assert!(small_report.is_watertight());
    assert_eq!(small_report.vertices, whole_report.vertices);
    assert!((small_report.volume / whole_report.volume - 1.0).abs() < 1e-3);
    home.done(&[
        "export",
        "export/ball-000-lod1.glb",
        "--format",
        "stl",
        "-o",
        "small",
    ]);
}

/// Projects points through the written files and through the calibration.
#[test]
fn a_colmap_dataset_projects_points_where_the_calibration_does() {
    let home = Home::new();
    let told = home.done(&[
        "export",
        "ball.mcap",
        "--dataset",
        "colmap",
        "--model",
        "out",
        "-o",
        "sets",
    ]);
    assert!(
        told.contains("sets/ball-000: colmap, 5 pictures, "),
        "{told}"
    );
    let rows = |name: &str| -> Vec<Vec<String>> {
        let text = std::fs::read_to_string(home.path("sets/ball-000/sparse/0").join(name)).unwrap();
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        lines
            .map(|line| line.split(' ').map(str::to_owned).collect())
            .collect()
    };
    let numbers = |row: &[String]| -> Vec<f64> { row.iter().map(|n| n.parse().unwrap()).collect() };
    let session = CaptureSession::open(&home.path("ball.mcap"), &Default::default()).unwrap();
    let (scene, _) = session.load(&CaptureId::new("ball-000").unwrap()).unwrap();
    let points: Vec<Point3<f64>> = rows("points3D.txt")
        .iter()
        .map(|r| Point3::from_slice(&numbers(&r[1..4])))
        .collect();
    assert!(points.len() > 100, "{}", points.len());
    let images = rows("images.txt");
    let (mut farthest, mut bent) = (0.0_f64, 0.0_f64);
    for (camera, image) in rows("cameras.txt").iter().zip(images.chunks_exact(2)) {
        assert_eq!(
            (camera[0].as_str(), camera[1].as_str()),
            (image[0][8].as_str(), "PINHOLE")
        );
        let picture = image[0][9].as_str();
        for path in [format!("images/{picture}"), format!("masks/{picture}.png")] {
            assert!(home.path("sets/ball-000").join(&path).is_file(), "{path}");
        }
        let view = scene
            .colors
            .iter()
            .find(|v| picture == format!("{}.png", v.camera.id))
            .unwrap();
        let (k, q) = (numbers(&camera[4..]), numbers(&image[0][1..8]));
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
        let camera_from_rig = Isometry3::from_parts(Translation3::new(q[4], q[5], q[6]), rotation);
        // Points of the model, and places all over the picture, where the lens distorts most.
        let grid = (0..5).flat_map(|y| {
            (0..5).map(move |x| Point2::new(f64::from(x) * 75.0 + 5.0, f64::from(y) * 55.0 + 5.0))
        });
        let ahead = |pixel| view.camera.center() + view.camera.ray(pixel).unwrap() * 0.8;
        for point in points.iter().copied().chain(grid.map(ahead)) {
            let p = camera_from_rig * point;
            let undistorted = [k[0] * p.x / p.z + k[2] - 0.5, k[1] * p.y / p.z + k[3] - 0.5];
            let (seen, _) = view.camera.project(point).unwrap();
            // The lens of the calibration takes the pixel of the dataset to where the camera saw the point.
            let lens = &view.camera.intrinsics;
            let ray = [0, 1].map(|i| (undistorted[i] - lens.center_px[i]) / lens.focal_px[i]);
            let back = lens.project(ray[0], ray[1], 1.0).unwrap();
            farthest = farthest.max((back - seen).norm());
            bent = bent.max((seen.x - undistorted[0]).hypot(seen.y - undistorted[1]));
        }
    }
    assert!(farthest < 0.1, "{farthest} px");
    assert!(
        bent > 0.2,
        "these lenses distort by {bent} px, which shows nothing"
    );
}

#[test]
fn the_other_datasets_have_their_files() {
    let home = Home::new();
    for (kind, files) in [
        (
            "nerfstudio",
            &["transforms.json", "points.ply", "scand.json"][..],
        ),
        ("openmvs", &["scene.mvs", "scand.json"]),
    ] {
        home.done(&[
            "export",
            "ball.mcap",
            "--dataset",
            kind,
            "--model",
            "out/ball/ball-000",
            "-o",
            kind,
        ]);
        for file in files {
            assert!(
                home.path(kind).join("ball-000").join(file).is_file(),
                "{kind}: {file}"
            );
        }
    }
    let told = home.done(&["export", "ball.mcap", "--dataset", "colmap", "-o", "bare"]);
    assert!(told.contains("no points (--model"), "{told}");
}

#[test]
fn a_recording_that_is_not_complete_is_exported_under_its_final_name() {
    let home = Home::new();
    std::fs::copy(home.path("ball.mcap"), home.path("other.mcap.part")).unwrap();
    home.hold(
        "export ball.mcap other.mcap.part --dataset colmap -o sets",
        0,
        &["sets/ball/ball-000: ", "sets/other/ball-000: "],
    );
    std::fs::copy(home.path("ball.mcap"), home.path("ball.mcap.part")).unwrap();
    home.hold(
        "export ball.mcap ball.mcap.part --dataset colmap -o none",
        2,
        &["ball.mcap.part", "another --out"],
    );
    let line = "export ball.mcap.part --dataset colmap --model out -o points";
    let told = home.done(&[line]);
    assert!(!told.contains("no points"), "{told}");
}

#[test]
fn what_cannot_be_exported_is_said_with_what_to_do() {
    let home = Home::new();
    std::fs::write(home.path("broken.glb"), b"glTF\x02\0\0\0").unwrap();
    std::fs::write(home.path("text.glb"), b"hello").unwrap();
    std::fs::create_dir(home.path("empty")).unwrap();
    std::fs::write(home.path("file"), b"").unwrap();
    std::fs::create_dir_all(home.path("mine/ball-000")).unwrap();
    std::fs::write(home.path("mine/ball-000/diary.txt"), b"dear").unwrap();
    let model = "out/ball/ball-000/model.glb";
    for (line, code, words) in [
        (
            format!("export {model} --format sdl"),
            2,
            &["did you mean stl?"][..],
        ),
        (
            format!("export {model} --format fbx"),
            2,
            &["obj, stl, 3mf, usdz or glb", "glb too"],
        ),
        (format!("export {model}"), 2, &["--format"]),
        (
            format!("export {model} --format stl --dataset colmap"),
            2,
            &["cannot be used with"],
        ),
        (
            format!("export {model} --format stl --lod 99"),
            2,
            &["99, expected 0 to 8"],
        ),
        (
            format!("export {model} --format glb --compress=draco"),
            2,
            &["C++", "gltfpack"],
        ),
        (
            format!("export {model} --format 3mf --compress"),
            2,
            &["always compressed"],
        ),
        (
            "export ball.mcap --format stl".into(),
            1,
            &["is a recording", "scand replay ball.mcap"],
        ),
        (
            "export out/ball/ball-000/model.ply --format stl".into(),
            1,
            &["model.glb beside it"],
        ),
        (
            "export empty --format stl".into(),
            1,
            &["empty", "no model.glb"],
        ),
        (
            "export missing.glb --format stl".into(),
            1,
            &["missing.glb"],
        ),
        (
            "export text.glb --format stl".into(),
            1,
            &["text.glb", "not a binary glTF"],
        ),
        (
            "export broken.glb --format stl".into(),
            1,
            &["broken.glb", "cannot be read"],
        ),
        (
            format!("export {model} --format stl -o file/below"),
            1,
            &["file/below"],
        ),
        (
            format!("export {model} --dataset colmap"),
            1,
            &["a recording (.mcap)"],
        ),
        (
            "export ball.mcap --dataset colmpa".into(),
            2,
            &["did you mean colmap?"],
        ),
        (
            "export ball.mcap --dataset colmap --capture ball-7".into(),
            1,
            &["\"ball-7\"", "ball-000"],
        ),
        (
            "export ball.mcap --dataset colmap --model text.glb".into(),
            1,
            &["text.glb"],
        ),
        (
            "export ball.mcap --dataset colmap -o mine".into(),
            1,
            &["already exists", "--force"],
        ),
        (
            "export ball.mcap --dataset colmap -o mine --force".into(),
            1,
            &["not a dataset that scand wrote"],
        ),
        ("convert out".into(), 2, &["scand export"]),
    ] {
        home.hold(&line, code, words);
    }
    assert!(home.path("mine/ball-000/diary.txt").is_file());
    assert!(!home.path("export").join("ball-000.stl").exists());
}

#[test]
fn a_file_is_replaced_only_with_force() {
    let home = Home::new();
    let line = "export out --format stl";
    home.hold(line, 0, &["millimetres, z up"]);
    let file = home.path("export/ball-000.stl");
    std::fs::write(&file, b"mine").unwrap();
    home.hold(line, 1, &["export/ball-000.stl already exists", "--force"]);
    assert_eq!(std::fs::read(&file).unwrap(), b"mine");
    home.hold("export out --format stl --force", 0, &[]);
    assert!(std::fs::read(&file).unwrap().len() > 84);
    // The same model twice is one; another of the same name is told, and the first one is there.
    home.hold("export out out --format obj", 0, &[]);
    copy_folder(&home.path("out"), &home.path("copy"));
    home.hold("export out copy --format usdz", 3, &["same name"]);
    assert!(home.path("export/ball-000.usdz").is_file());
    let line = "export ball.mcap --dataset colmap -o sets";
    home.hold(line, 0, &[]);
    home.hold(line, 1, &["already exists"]);
    home.hold("export ball.mcap --dataset nerfstudio -o sets -f", 0, &[]);
    assert!(
        !home.path("sets/ball-000/sparse").exists(),
        "the dataset was replaced whole"
    );
}

#[test]
fn a_rejected_model_is_exported_with_a_remark() {
    let home = Home::new();
    home.done(&["note", "ball-000", "reject", "--recording", "ball.mcap"]);
    // The report is older than the note.
    home.hold("export out --format stl", 0, &["the capture was rejected"]);
    std::fs::create_dir(home.path("elsewhere")).unwrap();
    home.hold(
        "export out --format stl -f --recordings elsewhere",
        0,
        &["elsewhere does not have ball.mcap", "--recordings"],
    );
    home.done(&["replay", "ball.mcap"]);
    home.hold(
        "export out --format stl -f --recordings elsewhere",
        0,
        &["the capture was rejected"],
    );
}

#[test]
fn notes_that_were_not_read_are_told_with_the_reason() {
    let home = Home::new();
    home.done(&["note", "ball-000", "reject", "--recording", "ball.mcap"]);
    std::fs::create_dir(home.path("there")).unwrap();
    let line = "export out --format stl -f --recordings there";
    let unread = "were not read, because ";
    // The notes of a recording that is not complete lie beside it, under its final name.
    for (from, to) in [
        ("ball.mcap", "ball.mcap.part"),
        ("ball.notes.jsonl", "ball.notes.jsonl"),
    ] {
        std::fs::copy(home.path(from), home.path("there").join(to)).unwrap();
    }
    home.hold(line, 0, &["the capture was rejected"]);
    let recording = home.path("there/ball.mcap");
    std::fs::write(&recording, "#ROSBAG V2.0\n").unwrap();
    home.hold(
        line,
        0,
        &[unread, "there/ball.mcap is not an MCAP file", "scand info"],
    );
    #[rustfmt::skip]
    home.done(&[
        "simulate", "--shape", "cup", "--cameras", "5", "--size", "160x120", "--masks", "--depth-cameras", "0",
        "--out", "cup.mcap",
    ]);
    std::fs::copy(home.path("cup.mcap"), &recording).unwrap();
    home.hold(
        line,
        0,
        &[unread, "there/ball.mcap has no capture ball-000: give"],
    );
    std::fs::copy(home.path("ball.mcap"), &recording).unwrap();
    home.hold(line, 0, &["the capture was rejected"]);
    let report = home.path("out/ball/ball-000/report.json");
    let text = std::fs::read_to_string(&report).unwrap();
    let time = "\"time_ns\": \"";
    std::fs::write(&report, text.replacen(time, &format!("{time}9"), 1)).unwrap();
    let words = "there/ball.mcap is another recording, in which capture ball-000 was triggered at another time";
    home.hold(line, 0, &[unread, words]);
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        match path.is_dir() {
            true => copy_folder(&path, &target),
            false => drop(std::fs::copy(&path, &target).unwrap()),
        }
    }
}

#[test]
fn captures_of_one_name_are_put_apart_and_a_damaged_model_stops_no_other() {
    let home = Home::new();
    copy_folder(&home.path("out/ball"), &home.path("out/other"));
    std::fs::copy(home.path("ball.mcap"), home.path("other.mcap")).unwrap();
    let output = home.done(&["export", "out", "--format", "obj", "-o", "both"]);
    for place in ["both/ball", "both/other"] {
        for ending in ["obj", "mtl", "png"] {
            assert!(
                home.path(&format!("{place}/ball-000.{ending}")).is_file(),
                "{output}"
            );
        }
    }
    let line = "export ball.mcap other.mcap --dataset colmap -o sets";
    home.hold(line, 0, &["sets/ball/ball-000: ", "sets/other/ball-000: "]);
    home.hold(&format!("{line} -f"), 0, &[]);
    std::fs::create_dir(home.path("twin")).unwrap();
    std::fs::copy(home.path("ball.mcap"), home.path("twin/ball.mcap")).unwrap();
    home.hold(
        "export ball.mcap twin/ball.mcap --dataset colmap -o none -f",
        2,
        &["twin/ball.mcap", "another --out"],
    );
    assert!(!home.path("none").exists());
    home.hold(
        "export ball.mcap ball.mcap --dataset colmap -o once",
        0,
        &["once/ball-000"],
    );
    // The damaged one comes first.
    std::fs::write(home.path("out/ball/ball-000/model.glb"), b"glTF").unwrap();
    home.hold(
        "export out --format stl -o rest",
        3,
        &["out/ball/ball-000/model.glb", "rest/other/ball-000.stl"],
    );
    home.hold(
        "publish out -o site",
        3,
        &["out/ball/ball-000/model.glb", "1 object"],
    );
    assert!(home.path("site/index.html").is_file());
    home.hold(
        "publish out/ball -o void",
        1,
        &["nothing is left to publish"],
    );
    assert!(!home.path("void").exists());
}

#[test]
fn a_dataset_takes_settings_and_a_calibration() {
    let home = Home::new();
    home.hold(
        "export ball.mcap --dataset colmap --set silhouette.nothing=1",
        78,
        &["silhouette"],
    );
    home.hold(
        "export out --format stl --set hull.resolution=40",
        2,
        &["--format"],
    );
    home.done(&["info", "ball.mcap", "--calibration", "other.toml"]);
    let text = std::fs::read_to_string(home.path("other.toml")).unwrap();
    let start = text.find("center_px = [").unwrap() + "center_px = [".len();
    let end = start + text[start..].find(',').unwrap();
    let moved = text[start..end].parse::<f64>().unwrap() + 7.25;
    let text = format!("{}{moved:?}{}", &text[..start], &text[end..]);
    std::fs::write(home.path("other.toml"), text).unwrap();
    let line = "export ball.mcap --dataset colmap -o";
    home.hold(&format!("{line} recorded"), 0, &[]);
    home.hold(&format!("{line} other --calibration other.toml"), 0, &[]);
    let [recorded, other] = ["recorded", "other"].map(|folder| {
        let file = home.path(folder).join("ball-000/scand.json");
        let sheet: serde_json::Value =
            serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
        sheet["calibration_sha256"].clone()
    });
    assert!(recorded.is_string() && recorded != other);
}

#[test]
fn a_level_of_detail_keeps_how_the_model_was_written() {
    let home = Home::new();
    home.done(&[
        "replay",
        "ball.mcap",
        "--set",
        "hull.resolution=40",
        "--set",
        "glb.unlit=true",
        "--set",
        "glb.jpeg_quality=60",
        "-q",
        "-o",
        "unlit",
    ]);
    home.done(&["export", "unlit", "--format", "glb", "--lod", "1"]);
    home.done(&[
        "export", "out", "--format", "glb", "--lod", "1", "-o", "lit",
    ]);
    let less = read(&home.path("export/ball-000-lod1.glb")).unwrap().glb;
    assert_eq!((less.unlit, less.jpeg_quality), (true, 60));
    let less = read(&home.path("lit/ball-000-lod1.glb")).unwrap().glb;
    assert_eq!((less.unlit, less.jpeg_quality), (false, 90));
}
