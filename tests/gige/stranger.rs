//! A camera that scand does not play: the library's own stand-alone simulator, which has no clock that can be read.

use crate::network::alone;
use scand::clock::Clock;
use scand::drivers::aravis::{ActionGroup, GigeDriver, Parameters};
use scand::drivers::live::{Driver, Pool, Shot};
use scand::frame::Picture;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The simulator, from the system or from where `tests/deps.sh` put it.
fn simulator() -> PathBuf {
    const NAME: &str = "arv-fake-gv-camera-0.8";
    let ours = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/aravis-tools/usr/bin");
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut folders = std::env::split_paths(&path).chain([ours]);
    let found = folders.find_map(|folder| Some(folder.join(NAME)).filter(|file| file.is_file()));
    found.expect("tests/deps.sh installs arv-fake-gv-camera-0.8 (package aravis-tools)")
}

struct Stranger(Child);

impl Drop for Stranger {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_camera_of_others_is_set_and_triggered() {
    alone("stranger::a_camera_of_others_is_set_and_triggered", || {
        let child = Command::new(simulator())
            .args(["-i", "127.0.1.7", "-s", "STRANGER"])
            .spawn();
        let _stranger = Stranger(child.unwrap());
        let parameters = Parameters {
            address: Some([127, 0, 1, 7].into()),
            serial: Some("STRANGER".into()),
            exposure: Some(0.01),
            packet_size: Some(8000),
            ..Parameters::default()
        };
        let clock = Clock::system();
        let id = crate::stand::id("c00");
        let pool = Pool::new(8 << 20);
        let mut driver = GigeDriver::new(id, parameters, pool, clock, ActionGroup::default());
        let until = Instant::now() + Duration::from_secs(10);
        let mut device = loop {
            match driver.open() {
                Ok(device) => break device,
                Err(fault) => assert!(Instant::now() < until, "{fault}"),
            }
            std::thread::sleep(Duration::from_millis(50));
        };
        let remarks = &device.info().remarks;
        assert!(
            remarks.iter().any(|r| r.contains("clock cannot be read")),
            "{remarks:?}"
        );
        let mut last = None;
        for number in 0..20 {
            let shot = Shot {
                number,
                trigger: clock.timestamp(),
                deadline: Instant::now() + Duration::from_secs(2),
                clock,
                abandoned: Arc::default(),
            };
            let mut frames = Vec::new();
            let stats = device
                .shoot(&shot, &mut |frame| frames.push(frame))
                .unwrap();
            assert_eq!((frames.len(), stats.lost.len()), (1, 0), "{stats:?}");
            let Picture::Raw {
                width,
                height,
                encoding,
                data,
                ..
            } = &frames[0].picture
            else {
                panic!("not raw")
            };
            assert_eq!((*width, *height, encoding.as_str()), (512, 512, "mono8"));
            // It shows a diagonal ramp that moves on by one with each frame.
            assert_eq!((data[1] as i32 - data[0] as i32).rem_euclid(255), 1);
            if let Some(last) = last.replace(data[0]) {
                assert_eq!(
                    (data[0] as i32 - last as i32).rem_euclid(255),
                    1,
                    "a frame was left out"
                );
            }
            let after = crate::stand::milliseconds_after(&shot, &frames[0]);
            // Between the trigger and the frame's arrival: with no clock to read, that is all that is known.
            assert!((-5.0..500.0).contains(&after), "{after} ms");
        }
    });
}
