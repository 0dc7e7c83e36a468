//! Data about a model in the vocabularies of archives: Dublin Core for the object, and CRMdig, the extension of CIDOC
//! CRM for digitisation, for how the model was made. They have the form of glTF's extension `KHR_xmp_json_ld`.
//! `design/metadata.md` names the sources.

use crate::description::Description;
use serde_json::{Map, Value, json};

/// The extension's name.
pub(super) const EXTENSION: &str = "KHR_xmp_json_ld";

/// The packet of a model.
pub(super) fn packet(about: &Description) -> Value {
    let mut packet = Map::new();
    packet.insert(
        "@context".into(),
        json!({
            "dc": "http://purl.org/dc/elements/1.1/",
            "dcterms": "http://purl.org/dc/terms/",
            "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
            "crmdig": "http://www.ics.forth.gr/isl/CRMdig/",
        }),
    );
    let mut put = |name: &str, value: Option<Value>| {
        if let Some(value) = value {
            packet.insert(name.into(), value);
        }
    };
    put("@id", Some("".into()));
    put("dc:format", Some("model/gltf-binary".into()));
    put("dc:type", Some(json!({ "@set": ["PhysicalObject"] })));
    // The object's number where it is known: that is what an archive looks for.
    let number = about.subject.as_deref().unwrap_or(&about.capture);
    put("dc:identifier", Some(number.into()));
    put("dc:title", about.title.as_deref().map(in_default_language));
    put(
        "dc:rights",
        about.rights.as_deref().map(in_default_language),
    );
    put(
        "dc:creator",
        about
            .operator
            .as_deref()
            .map(|name| json!({ "@list": [name] })),
    );
    put("dc:date", Some(json!({ "@list": [about.time] })));
    put("dc:source", Some(urn(&about.input_sha256).into()));
    let parts = about.project.iter().chain(&about.session);
    let parts: Vec<&String> = parts.collect();
    put(
        "dcterms:isPartOf",
        (!parts.is_empty()).then(|| json!({ "@set": parts })),
    );
    put("crmdig:L11i_was_output_of", Some(digitization(about)));
    Value::Object(packet)
}

/// How the model was made: the capture at the rig, and the program that made a model of it.
fn digitization(about: &Description) -> Value {
    let mut process = Map::new();
    let mut put = |name: &str, value: Option<&str>| {
        if let Some(value) = value {
            process.insert(name.into(), value.into());
        }
    };
    put("@type", Some("crmdig:D2_Digitization_Process"));
    let captures = about.captures.as_ref().unwrap_or(&about.capture);
    put("dc:identifier", Some(captures));
    put("crmdig:L1_digitized", about.subject.as_deref());
    put("crmdig:L12_happened_on_device", about.rig.as_deref());
    put("crmdig:L30_has_operator", about.operator.as_deref());
    put("crmdig:L31_has_starting_date-time", Some(&about.time));
    put("crmdig:L23_used_software_or_firmware", Some(&about.program));
    put("crmdig:L10_had_input", Some(&urn(&about.input_sha256)));
    put(
        "crmdig:L13_used_parameters",
        Some(&urn(&about.calibration_sha256)),
    );
    Value::Object(process)
}

fn urn(sha256: &str) -> String {
    format!("urn:sha256:{sha256}")
}

fn in_default_language(text: &str) -> Value {
    json!({ "@type": "rdf:Alt", "rdf:_1": { "@language": "x-default", "@value": text } })
}
