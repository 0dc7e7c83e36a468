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
