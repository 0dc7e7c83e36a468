//! Calibration from picture files: the same pictures give the same calibration as a recording of them does.

use assert_cmd::Command;
use scand::calibration::RigCalibration;
use scand::frame::Picture;
use scand::recording::Compression;
use scand_lab::{BoardOptions, BoardSession, Encoding, Options, write_board_session};
use std::path::Path;

fn session() -> BoardSession {
    let mut options = Options {
        width: 640,
        height: 480,
        depth_cameras: 0,
        ..Options::for_boards()
    };
    options.color.encoding = Encoding::Png;
    // Two neighbours of the ring.
    let others = (0..options.cameras).filter(|k| ![0, 2].contains(k));
    options.faults.missing = others.map(|k| format!("c{k:02}")).collect();
    let boards = BoardOptions {
        placements: 24,
        ..BoardOptions::default()
    };
    BoardSession::new(options, boards).unwrap()
}

/// Each camera's pictures in a folder of its own, numbered as the placements are.
fn write_files(session: &BoardSession, folder: &Path) {
    for index in 0..session.placements().len() {
        for frame in session.capture(index).unwrap().frames {
            let Picture::Compressed { data, .. } = frame.picture else {
                panic!("pictures are PNG files")
            };
            let of_camera = folder.join(frame.camera.as_str());
            std::fs::create_dir_all(&of_camera).unwrap();
            std::fs::write(of_camera.join(format!("{index}.png")), data).unwrap();
        }
    }
}

fn calibrate(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_scand"))
        .current_dir(folder)
        .arg("calibrate")
        .args(arguments)
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), words)
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn a_folder_of_pictures_a_camera_gives_what_a_recording_of_them_gives() {
        let folder = tempfile::tempdir().unwrap();
        let session = session();
        write_files(&session, folder.path());
        let recording = folder.path().join("session.mcap");
        write_board_session(&session, &recording, Compression::None).unwrap();
        let load = |name: &str| RigCalibration::load(&folder.path().join(name)).unwrap();
        let run = |arguments: &[&str]| {
            let (code, words) = calibrate(folder.path(), arguments);
            assert_eq!(code, Some(0), "{words}");
        };
        run(&[
            "session.mcap",
            "--out",
            "recorded.toml",
            "--accept-doubtful",
        ]);
        let board = [
            "--board",
            "checkerboard:9x6:25mm",
            "--accept-doubtful",
            "--out",
        ];
        let by_pattern = [
            "--pictures",
            "c00=c00/*.png",
            "c02=c02/*.png",
            "--report",
            "report.html",
        ];
        run(&[&by_pattern[..], &board, &["files.toml"]].concat());
        run(&[
            &["--pictures", "c00=c00", "--pictures", "c02=c02"],
            &board[..],
            &["folders.toml"],
        ]
        .concat());
        let recorded = load("recorded.toml");
        assert_eq!(recorded.cameras.len(), 2);
        let by_files = load("files.toml");
        assert_eq!(load("folders.toml").cameras, by_files.cameras);
        // The recording has cameras that saw nothing, beside which sums are rounded otherwise.
        for (id, (camera, _)) in &recorded.cameras {
            let (found, _) = &by_files.cameras[id];
            let focal = found.intrinsics.focal_px - camera.intrinsics.focal_px;
            let place = found.rig_from_camera.translation.vector
                - camera.rig_from_camera.translation.vector;
            assert!(
                focal.norm() < 1e-6 && place.norm() < 1e-9,
                "{found:?} {camera:?}"
            );
        }
        // The report has pictures in it, and is no larger than a mail takes.
        let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
        assert!(page.contains("The worst views") && page.contains("data:image/jpeg;base64,"));
        assert!(page.len() < 1_500_000, "{}", page.len());

        // A picture that is missing is named by the numbers of both.
        std::fs::remove_file(folder.path().join("c02/7.png")).unwrap();
        let (code, words) = calibrate(
            folder.path(),
            &[&by_pattern[..], &board, &["none.toml"]].concat(),
        );
        assert_eq!(code, Some(1), "{words}");
        assert!(
            words.contains("c00 24, c02 23")
                && words.contains("c02 has no picture with the number 7"),
            "{words}"
        );
        std::fs::remove_file(folder.path().join("c00/3.png")).unwrap();
        let arguments = [&by_pattern[..3], &board, &["shifted.toml"]].concat();
        let (_, words) = calibrate(folder.path(), &arguments);
        assert!(
            words.contains("4.png and 3.png are used as one placement"),
            "{words}"
        );
        let (code, words) = calibrate(folder.path(), &["--pictures", "c00/*.png"]);
        assert_eq!(code, Some(2), "{words}");
    }
}
