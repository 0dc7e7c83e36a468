//! 3MF (3D Manufacturing Format, core 1.3 with the material extension): millimetres, z up, the surface welded, so that
//! a slicer finds a solid, and the texture as PNG.

use super::zip::{self, Entry};
use super::{Error, known, unique_uv};
use crate::description::{Description, clean};
use crate::markup::escaped;
use crate::output::encode_png;
use crate::reconstruct::Model;
use std::fmt::Write;

const CONTENT_TYPES: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
<Default Extension="png" ContentType="image/png"/>
</Types>
"#;
const RELATIONS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="model" Target="/3D/3dmodel.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"#;
const TEXTURE_RELATIONS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="atlas" Target="/3D/Textures/atlas.png" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture"/>
</Relationships>
"#;

/// A model as the bytes of a .3mf.
///
/// # Errors
/// If the texture cannot be encoded, or the package is too large.
pub(super) fn encode(model: &Model, about: &Description) -> Result<Vec<u8>, Error> {
    let atlas = model.texture.as_ref().map(|t| encode_png(&t.atlas));
    let atlas = atlas.transpose()?;
    let xml = document(model, about);
    let text = |name, text: &'static str| Entry {
        name,
        bytes: text.as_bytes(),
        deflate: true,
    };
    let mut entries = vec![
        text("[Content_Types].xml", CONTENT_TYPES),
        text("_rels/.rels", RELATIONS),
        Entry {
            name: "3D/3dmodel.model",
            bytes: xml.as_bytes(),
            deflate: true,
        },
    ];
    if let Some(atlas) = &atlas {
        entries.push(text("3D/_rels/3dmodel.model.rels", TEXTURE_RELATIONS));
        entries.push(Entry {
            name: "3D/Textures/atlas.png",
            bytes: atlas,
            deflate: false,
        });
    }
    zip::pack(&entries, 1, "3MF")
}

fn document(model: &Model, about: &Description) -> String {
    let mut xml = String::from(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02">
"#,
    );
    let title = about.title.as_ref().or(about.subject.as_ref());
    let metadata = [
        ("Title", title.unwrap_or(&about.capture).clone()),
        ("Designer", about.operator.clone().unwrap_or_default()),
        ("Copyright", about.rights.clone().unwrap_or_default()),
        ("Application", about.program.clone()),
        ("Description", known(about).join("; ")),
    ];
    for (name, text) in metadata {
        if let Some(text) = clean_long(&text) {
            let _ = writeln!(xml, "<metadata name=\"{name}\">{text}</metadata>");
        }
    }
    xml.push_str("<resources>\n");
    let corners = push_texture(&mut xml, model);
    let material = if corners.is_empty() {
        ""
    } else {
        r#" pid="2" pindex="0""#
    };
    let _ = writeln!(
        xml,
        r#"<object id="3" type="model"{material}><mesh><vertices>"#
    );
    for vertex in &model.mesh.vertices {
        let [x, y, z] = (vertex.coords * 1000.0).into();
        let _ = writeln!(xml, r#"<vertex x="{x}" y="{y}" z="{z}"/>"#);
    }
    xml.push_str("</vertices><triangles>\n");
    for (t, [a, b, c]) in model.mesh.triangles.iter().enumerate() {
        let _ = write!(xml, r#"<triangle v1="{a}" v2="{b}" v3="{c}""#);
        if let Some([p, q, r]) = corners.get(t) {
            let _ = write!(xml, r#" pid="2" p1="{p}" p2="{q}" p3="{r}""#);
        }
        xml.push_str("/>\n");
    }
    xml.push_str("</triangles></mesh></object>\n</resources>\n<build><item objectid=\"3\"/></build>\n</model>\n");
    xml
}

/// Declares the texture and the places in it; for each triangle which of them its corners have.
fn push_texture(xml: &mut String, model: &Model) -> Vec<[u32; 3]> {
    let Some(texture) = &model.texture else {
        return Vec::new();
    };
    let (places, corners) = unique_uv(texture);
    xml.push_str(r#"<m:texture2d id="1" path="/3D/Textures/atlas.png" contenttype="image/png" tilestyleu="clamp" tilestylev="clamp"/>
<m:texture2dgroup id="2" texid="1">
"#);
    for [u, v] in places {
        // Up from the bottom edge.
        let _ = writeln!(xml, r#"<m:tex2coord u="{u}" v="{}"/>"#, 1.0 - v);
    }
    xml.push_str("</m:texture2dgroup>\n");
    corners
}

/// A text of one line as XML holds it, whatever it has; `None` if nothing is left.
fn clean_long(text: &str) -> Option<String> {
    let words: Vec<String> = text.split("; ").filter_map(clean).collect();
    // What XML 1.0 cannot hold, even escaped.
    let allowed = |c: &char| !matches!(c, '\u{fffe}' | '\u{ffff}');
    let kept: String = words.join("; ").chars().filter(allowed).collect();
    // The reference reader, lib3mf, knows the named escapes alone. Between tags an apostrophe needs none.
    (!kept.is_empty()).then(|| escaped(&kept).replace("&#39;", "'"))
}

#[cfg(test)]
mod tests {
    use super::super::testing::{described, textured_square};
    use super::*;

    #[test]
    fn the_document_has_millimetres_and_texture_and_escapes_what_people_wrote() {
        let mut about = described("a");
        about.title = Some("</model><x>&'\u{1b}".into());
        let xml = document(&textured_square(), &about);
        assert!(xml.contains(r#"unit="millimeter""#));
        assert!(xml.contains(r#"<vertex x="1000" y="0" z="250"/>"#), "{xml}");
        assert!(
            xml.contains("name=\"Title\">&lt;/model&gt;&lt;x&gt;&amp;'</metadata>"),
            "{xml}"
        );
        assert!(xml.contains(r#"<triangle v1="0" v2="2" v3="3" pid="2" p1="1" p2="3" p3="2"/>"#));
        assert_eq!(xml.matches("</model>").count(), 1);
    }

    #[test]
    fn the_same_model_makes_the_same_package() {
        let encoded = || encode(&textured_square(), &described("a")).unwrap();
        assert_eq!(encoded(), encoded());
    }
}
