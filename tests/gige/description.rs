//! A GenICam description with features that real cameras have and the simulator does not: the simulator's own, with
//! features added in memory that it does not use.

use aravis::FakeCamera;
use std::path::PathBuf;

/// Where the added features lie.
pub const EXPOSURE_AUTO: u32 = 0x2008;
pub const BALANCE_AUTO: u32 = 0x200c;
pub const PTP_ENABLE: u32 = 0x2040;
pub const PTP_STATUS: u32 = 0x2044;
pub const PTP_OFFSET: u32 = 0x2048;
pub const ACTION_DEVICE_KEY: u32 = 0x2050;
pub const ACTION_GROUP_KEY: u32 = 0x2058;
pub const ACTION_GROUP_MASK: u32 = 0x205c;
pub const TRANSMISSION_DELAY: u32 = 0x2060;
pub const TEMPERATURE: u32 = 0x2070;

/// While this is 1, a camera of [`write_binning`] acknowledges what is written to `BinningHorizontal`, and takes 2.
pub const STUCK: u32 = 0x2100;
pub const WIDTH: u32 = 0x100;
pub const HEIGHT: u32 = 0x104;
pub const BINNING: [u32; 2] = [0x108, 0x10c];

/// Entries of `PtpStatus`.
pub const LISTENING: u32 = 1;
pub const SLAVE: u32 = 3;

/// Writes the description into `folder`.
pub fn write(folder: &std::path::Path) -> PathBuf {
    let (own, _) = FakeCamera::new("any").genicam_xml();
    let entry = "<EnumEntry Name=\"Action1\" NameSpace=\"Standard\"><Value>2</Value></EnumEntry>";
    let line = "<EnumEntry Name=\"Line0\"";
    assert_eq!(own.matches(line).count(), 1);
    let own = own.replace(line, &format!("{entry}{line}"));
    let end = "</RegisterDescription>";
    assert_eq!(own.matches(end).count(), 1);
    let path = folder.join("camera.xml");
    std::fs::write(&path, own.replace(end, &format!("{}{end}", added()))).unwrap();
    path
}

/// Writes the simulator's own description with binning that does not take what is written while the stream runs, as
/// that of real cameras, which lock it then.
pub fn write_binning(folder: &std::path::Path) -> PathBuf {
    let (own, _) = FakeCamera::new("any").genicam_xml();
    let own = own.to_string();
    let replaced = |text: String, from: &str, to: &str| {
        assert_eq!(text.matches(from).count(), 1, "{from}");
        text.replace(from, to)
    };
    let axes = ["BinningHorizontal", "BinningVertical"];
    let text = axes.into_iter().fold(own, |text, name| {
        let from = format!("<pValue>{name}Register</pValue>");
        replaced(text, &from, &format!("<pValue>{name}Lock</pValue>"))
    });
    let place = text.find("<Address>0x124</Address>").unwrap();
    let (before, after) = text.split_at(place);
    let text = format!("{before}{}", after.replacen("WO", "RW", 1));
    let locks: String = axes.into_iter().map(lock).collect();
    let stuck = integer("Stuck", STUCK, "RW", "Unsigned");
    let end = "</RegisterDescription>";
    let text = replaced(text, end, &format!("{locks}{stuck}{end}"));
    let path = folder.join("binning.xml");
    std::fs::write(&path, text).unwrap();
    path
}

/// What becomes of a value that is written to a camera's binning.
fn lock(name: &str) -> String {
    let taken = match name {
        "BinningHorizontal" => "((STUCK = 1) ? 2 : FROM)",
        _ => "FROM",
    };
    format!(
        "<IntConverter Name=\"{name}Lock\"><pVariable Name=\"STUCK\">Stuck</pVariable>\
         <pVariable Name=\"RUNS\">AcquisitionCommandRegister</pVariable>\
         <pVariable Name=\"OLD\">{name}Register</pVariable>\
         <FormulaTo>(RUNS = 1) ? OLD : {taken}</FormulaTo><FormulaFrom>TO</FormulaFrom>\
         <pValue>{name}Register</pValue></IntConverter>"
    )
}

fn added() -> String {
    [
        enumeration("ExposureAuto", EXPOSURE_AUTO, "RW", &["Off", "Continuous"]),
        enumeration("BalanceWhiteAuto", BALANCE_AUTO, "RW", &["Off", "Continuous"]),
        enumeration("BalanceRatioSelector", 0x2010, "RW", &["Red", "Green", "Blue"]),
        float("Gain", "<Address>0x2000</Address>", 0.0, 24.0),
        float(
            "BalanceRatio",
            "<Address>0x2020</Address><pIndex Offset=\"8\">BalanceRatioSelectorRegister</pIndex>",
            0.25,
            8.0,
        ),
        float(
            "DeviceTemperature",
            &format!("<Address>0x{TEMPERATURE:x}</Address>"),
            -40.0,
            125.0,
        ),
        boolean("PtpEnable", PTP_ENABLE),
        enumeration(
            "PtpStatus",
            PTP_STATUS,
            "RO",
            &["Initializing", "Listening", "Master", "Slave"],
        ),
        integer("PtpOffsetFromMaster", PTP_OFFSET, "RO", "Signed"),
        integer("ActionDeviceKey", ACTION_DEVICE_KEY, "RW", "Unsigned"),
        integer("ActionSelector", 0x2054, "RW", "Unsigned"),
        integer("ActionGroupKey", ACTION_GROUP_KEY, "RW", "Unsigned"),
        integer("ActionGroupMask", ACTION_GROUP_MASK, "RW", "Unsigned"),
        integer("GevSCFTD", TRANSMISSION_DELAY, "RW", "Unsigned"),
        integer("CoarseRegister", 0x2064, "RW", "Unsigned"),
        // Takes steps of four, as a camera may.
        "<IntConverter Name=\"Coarse\"><FormulaTo>FROM / 4</FormulaTo><FormulaFrom>TO * 4</FormulaFrom>\
         <pValue>CoarseRegister</pValue></IntConverter>"
            .into(),
    ]
    .concat()
}

fn integer(name: &str, address: u32, access: &str, sign: &str) -> String {
    format!(
        "<IntReg Name=\"{name}\"><Address>0x{address:x}</Address><Length>4</Length><AccessMode>{access}</AccessMode>\
         <pPort>Device</pPort><Sign>{sign}</Sign><Endianess>BigEndian</Endianess></IntReg>"
    )
}

fn boolean(name: &str, address: u32) -> String {
    format!(
        "<Boolean Name=\"{name}\"><pValue>{name}Register</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>{}",
        integer(&format!("{name}Register"), address, "RW", "Unsigned")
    )
}

fn enumeration(name: &str, address: u32, access: &str, entries: &[&str]) -> String {
    let entries = entries.iter().enumerate();
    let entries: String = entries
        .map(|(i, entry)| format!("<EnumEntry Name=\"{entry}\"><Value>{i}</Value></EnumEntry>"))
        .collect();
    format!(
        "<Enumeration Name=\"{name}\">{entries}<pValue>{name}Register</pValue></Enumeration>{}",
        integer(&format!("{name}Register"), address, access, "Unsigned")
    )
}

fn float(name: &str, place: &str, least: f64, most: f64) -> String {
    format!(
        "<Float Name=\"{name}\"><pValue>{name}Register</pValue><Min>{least}</Min><Max>{most}</Max></Float>\
         <FloatReg Name=\"{name}Register\">{place}<Length>8</Length><AccessMode>RW</AccessMode>\
         <pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>"
    )
}
