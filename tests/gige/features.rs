//! Settings: the camera takes them, or they are refused with the camera's own answer.

use crate::description;
use crate::network::alone;
use crate::stand::{Stand, id};
use scand::drivers::aravis::{FeatureValue, Parameters, Region, TriggerMode};
use scand::drivers::live::Fault;
use scand::drivers::pixel_format::PixelFormat;
use scand_lab::serve::ColorOptions;

#[test]
fn what_a_camera_does_not_take_is_refused_with_its_answer() {
    alone(
        "features::what_a_camera_does_not_take_is_refused_with_its_answer",
        || {
            let stand = Stand::new([64, 48]);
            let all = || stand.parameters("c00");
            let region = |x, width| Region {
                x,
                y: 0,
                width,
                height: 48,
            };
            let feature = |name: &str, value| Some([(name.to_owned(), value)].into());
            let cases = [
                (
                    Parameters {
                        pixel_format: Some(PixelFormat::Uyvy),
                        ..all()
                    },
                    "PixelFormat",
                    "BayerGR8",
                ),
                (
                    Parameters {
                        gain_db: Some(3.0),
                        ..all()
                    },
                    "Gain",
                    "no such feature",
                ),
                (
                    Parameters {
                        gain_raw: Some(11),
                        ..all()
                    },
                    "GainRaw",
                    "0 to 10",
                ),
                (
                    Parameters {
                        exposure: Some(11.0),
                        ..all()
                    },
                    "ExposureTimeAbs",
                    "10000000",
                ),
                (
                    Parameters {
                        white_balance: Some([1.0; 3]),
                        ..all()
                    },
                    "BalanceRatio",
                    "no such feature",
                ),
                (
                    Parameters {
                        auto_exposure: Some(true),
                        ..all()
                    },
                    "ExposureAuto",
                    "",
                ),
                (
                    Parameters {
                        ptp: Some(true),
                        ..all()
                    },
                    "PtpEnable",
                    "no such feature",
                ),
                (
                    Parameters {
                        region: Some(region(0, 128)),
                        ..all()
                    },
                    "Width",
                    "64",
                ),
                (
                    Parameters {
                        transmission_delay_ns: Some(5),
                        ..all()
                    },
                    "GevSCFTD",
                    "no such feature",
                ),
                (
                    Parameters {
                        trigger: Some(TriggerMode::Line),
                        ..all()
                    },
                    "TriggerSource",
                    "",
                ),
                (
                    Parameters {
                        trigger: Some(TriggerMode::Action),
                        ..all()
                    },
                    "PtpEnable",
                    "no such",
                ),
                (
                    Parameters {
                        features: feature("Gamma", FeatureValue::Float(1.0)),
                        ..all()
                    },
                    "Gamma",
                    "no such",
                ),
                (
                    Parameters {
                        features: feature("DeviceModelName", FeatureValue::Text("X".into())),
                        ..all()
                    },
                    "DeviceModelName",
                    "",
                ),
            ];
            for (parameters, named, answer) in cases {
                let words = format!("{parameters:?}");
                match stand.open("c00", parameters) {
                    Err(Fault::Refused { field, found, .. }) => {
                        assert!(field.contains(named), "{field}: {found}");
                        assert!(
                            found.contains(answer) && !found.is_empty(),
                            "{field}: {found}"
                        );
                    }
                    Err(other) => panic!("{named}: {other}"),
                    Ok(_) => panic!("taken: {words}"),
                }
            }
            // Nothing is held after a refusal.
            assert!(stand.open("c00", all()).is_ok());
            // A camera that cannot wait can be the first one of its link.
            let first = Parameters {
                transmission_delay_ns: Some(0),
                ..all()
            };
            assert!(stand.open("c00", first).is_ok());
        },
    );
}

#[test]
fn settings_are_read_back_for_the_recording() {
    alone("features::settings_are_read_back_for_the_recording", || {
        let stand = Stand::new([64, 48]);
        let parameters = Parameters {
            exposure: Some(0.004),
            gain_raw: Some(4),
            pixel_format: Some(PixelFormat::BayerGrbg8),
            features: Some([("TestRegister".into(), FeatureValue::Integer(77))].into()),
            ..stand.parameters("c00")
        };
        let device = stand.open("c00", parameters).unwrap();
        let info = device.info();
        let settings = info.settings.as_ref().unwrap();
        assert!((settings.exposure.unwrap() - 0.004).abs() < 1e-6);
        assert_eq!(settings.trigger.as_deref(), Some("Software"));
        let names: Vec<&str> = info.table.iter().map(|row| row[0].as_str()).collect();
        // What starts exposures comes last, and the packets after the format.
        let place = |name| {
            names
                .iter()
                .position(|n| *n == name)
                .unwrap_or_else(|| panic!("{name} in {names:?}"))
        };
        assert!(place("TestRegister") < place("PixelFormat"));
        assert!(place("PixelFormat") < place("GevSCPSPacketSize"));
        assert!(place("GevSCPSPacketSize") < place("TriggerSource"));
        assert!(place("TriggerSource") < place("TriggerMode"));
        for [name, asked, found] in &info.table {
            assert!(!name.is_empty() && !asked.is_empty() && !found.is_empty());
        }
    });
}

#[test]
fn a_camera_with_all_features_is_set_as_asked() {
    alone(
        "features::a_camera_with_all_features_is_set_as_asked",
        || {
            let folder = tempfile::tempdir().unwrap();
            let options = ColorOptions {
                features: Some(description::write(folder.path())),
                ..ColorOptions::default()
            };
            let stand = Stand::with([64, 48], options);
            let camera = id("c00");
            // As the last user left it.
            stand
                .rig
                .set_register(&camera, description::EXPOSURE_AUTO, 1);
            stand
                .rig
                .set_register(&camera, description::BALANCE_AUTO, 1);
            let all = Parameters {
                exposure: Some(0.002),
                gain_db: Some(6.5),
                white_balance: Some([1.75, 1.0, 2.5]),
                transmission_delay_ns: Some(123_000),
                features: Some([("Coarse".into(), FeatureValue::Integer(8))].into()),
                ..stand.parameters("c00")
            };
            let device = stand.open("c00", all.clone()).unwrap();
            let settings = device.info().settings.clone().unwrap();
            assert_eq!(settings.gain_db, Some(6.5));
            assert_eq!(settings.white_balance, Some([1.75, 1.0, 2.5]));
            let register = |address| stand.rig.register(&camera, address).unwrap();
            assert_eq!(register(description::EXPOSURE_AUTO), 0);
            assert_eq!(register(description::BALANCE_AUTO), 0);
            assert_eq!(register(description::TRANSMISSION_DELAY), 123_000);
            drop(device);
            // Automatic where it is asked for.
            let automatic = Parameters {
                auto_exposure: Some(true),
                ..stand.parameters("c00")
            };
            drop(stand.open("c00", automatic).unwrap());
            assert_eq!(register(description::EXPOSURE_AUTO), 1);
            // Taken in part only.
            let coarse = Parameters {
                features: Some([("Coarse".into(), FeatureValue::Integer(7))].into()),
                ..all.clone()
            };
            match stand.open("c00", coarse).err().unwrap() {
                Fault::Refused {
                    field,
                    asked,
                    found,
                } => {
                    assert_eq!([field, asked, found], ["Coarse", "7", "4"]);
                }
                other => panic!("{other}"),
            }
            let loud = Parameters {
                gain_db: Some(30.0),
                ..all
            };
            let loud = stand.open("c00", loud).err().unwrap().to_string();
            assert!(loud.contains("0 to 24"), "{loud}");
        },
    );
}
