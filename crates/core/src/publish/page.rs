//! The pages of a published folder: a gallery, and a page for each object. No script is written into a page, none
//! comes from elsewhere, and a page without its viewer still shows a picture and the files.

use super::{LevelFile, PublishedObject};
use crate::description::provenance_words;
use crate::level::Level;
use crate::markup::escaped;
use std::fmt::Write;

/// The style of all pages, `style.css`.
pub const STYLE: &str = include_str!("style.css");

/// Nothing is loaded but from the folder itself; the viewer decodes a model's texture from a blob.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self' blob:";

/// What the pages have beside the objects.
#[derive(Clone, Copy, Debug)]
pub struct PageOptions<'a> {
    /// The gallery's title.
    pub title: &'a str,
    /// Whether `viewer.js` is in the folder.
    pub has_viewer: bool,
    /// Whether there are manifests.
    pub has_manifests: bool,
}

/// The gallery, `index.html`.
pub fn gallery(objects: &[PublishedObject], options: PageOptions<'_>) -> String {
    let mut body = format!(
        "<h1>{}</h1>\n<ul class=\"gallery\">\n",
        escaped(options.title)
    );
    for object in objects {
        let [width, depth, height] = object.size_mm();
        let _ = writeln!(
            body,
            "<li><a href=\"objects/{id}/index.html\"><img src=\"objects/{id}/{picture}\" alt=\"\" width=\"{}\" height=\"{}\" \
             loading=\"lazy\"><span dir=\"auto\">{heading}</span></a> <span class=\"quiet\">{width:.0} × {depth:.0} × {height:.0} mm\
             </span></li>",
            object.thumbnail.size.0,
            object.thumbnail.size.1,
            id = object.id,
            picture = object.thumbnail.name,
            heading = escaped(&object.heading()),
        );
    }
    body += "</ul>\n";
    if options.has_manifests {
        body += "<p><a href=\"collection.json\">IIIF collection</a></p>\n";
    }
    page(options.title, "", &body, false)
}

/// The page of an object, `objects/ID/index.html`.
pub fn object_page(object: &PublishedObject, options: PageOptions<'_>) -> String {
    let heading = object.heading();
    let mut body = format!(
        "<p><a href=\"../../index.html\">{}</a></p>\n<h1 dir=\"auto\">{}</h1>\n",
        escaped(options.title),
        escaped(&heading)
    );
    body += &shown(object, options.has_viewer);
    body += &verdict(object);
    body += &table("The object and its model", &known(object));
    body += &shares(object);
    body += &notes(object);
    body += &files(object, options);
    page(&heading, "../../", &body, options.has_viewer)
}

fn page(title: &str, top: &str, body: &str, has_viewer: bool) -> String {
    let script = match has_viewer {
        true => format!("<script type=\"module\" src=\"{top}viewer.js\"></script>\n"),
        false => String::new(),
    };
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\">\n<meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"referrer\" content=\"no-referrer\">\n<title>{}</title>\n<link rel=\"stylesheet\" \
         href=\"{top}style.css\">\n{script}</head>\n<body>\n<main>\n{body}</main>\n</body>\n</html>\n",
        escaped(title)
    )
}

/// The picture and, where there is a viewer, what it needs: the levels of detail, the least detailed first.
fn shown(object: &PublishedObject, has_viewer: bool) -> String {
    let picture = format!(
        "<img class=\"picture\" src=\"{}\" alt=\"A picture of the model\" width=\"{}\" height=\"{}\">\n",
        object.picture.name, object.picture.size.0, object.picture.size.1
    );
    if !has_viewer {
        return picture;
    }
    let levels = object.levels.iter().rev();
    let levels = levels.map(|level| {
        format!(
            "<li data-level=\"{}\">{}</li>",
            level.name,
            level_words(level)
        )
    });
    format!(
        "<section class=\"viewer\" aria-label=\"The model\">\n{picture}<ul class=\"levels\" hidden>{}</ul>\n</section>\n",
        levels.collect::<String>()
    )
}

fn level_words(level: &LevelFile) -> String {
    format!("{} triangles, {}", level.triangles, bytes(level.bytes))
}

fn bytes(bytes: usize) -> String {
    match bytes {
        0..1_000_000 => format!("{} kB", bytes.div_ceil(1000)),
        _ => format!("{:.1} MB", bytes as f64 * 1e-6),
    }
}

fn verdict(object: &PublishedObject) -> String {
    let words = match object.facts.level {
        Some(Level::Green) => "The program that made the model found no problem.",
        Some(Level::Amber) => "The model can be used, but a person should look at it.",
        Some(Level::Red) => "The model should not be used.",
        None => "It is not known how far the model can be trusted.",
    };
    let name = object.facts.level.map_or("unknown", Level::name);
    let mut out = format!("<p><strong class=\"verdict {name}\">{name}</strong> {words}</p>\n");
    if !object.facts.reasons.is_empty() {
        out += "<ul>\n";
        for reason in &object.facts.reasons {
            let _ = writeln!(
                out,
                "<li><code>{}</code> {}</li>",
                escaped(&reason.code),
                escaped(&reason.words)
            );
        }
        out += "</ul>\n";
    }
    out
}

fn known(object: &PublishedObject) -> Vec<(&'static str, String)> {
    let (about, facts) = (&object.about, &object.facts);
    let [width, depth, height] = object.size_mm();
    let triangles = object
        .levels
        .first()
        .map(|level| level.triangles.to_string());
    let pairs = [
        ("Number", about.subject.clone()),
        ("Title", about.title.clone()),
        ("Rights", about.rights.clone()),
        (
            "Width, depth, height",
            Some(format!("{width:.1} × {depth:.1} × {height:.1} mm")),
        ),
        (
            "Volume",
            facts
                .volume
                .map(|volume| format!("{:.1} cm³", volume * 1e6)),
        ),
        ("Triangles", triangles),
        (
            "Closed surface",
            facts
                .is_watertight
                .map(|closed| if closed { "yes" } else { "no" }.to_owned()),
        ),
        ("Captured", Some(about.time.clone())),
        ("Capture", Some(about.capture.clone())),
        ("Captures", about.captures.clone()),
        ("Session", about.session.clone()),
        ("Operator", about.operator.clone()),
        ("Project", about.project.clone()),
        ("Rig", about.rig.clone()),
        ("Made by", Some(about.program.clone())),
        ("SHA-256 of the input", Some(about.input_sha256.clone())),
        (
            "SHA-256 of the calibration",
            Some(about.calibration_sha256.clone()),
        ),
    ];
    let pairs = pairs
        .into_iter()
        .filter_map(|(name, text)| Some((name, text?)));
    pairs.filter(|(_, text)| !text.is_empty()).collect()
}

fn table(caption: &str, rows: &[(&str, String)]) -> String {
    let mut out = format!("<h2>{caption}</h2>\n<table>\n");
    for (name, text) in rows {
        let _ = writeln!(
            out,
            "<tr><th scope=\"row\">{name}</th><td dir=\"auto\">{}</td></tr>",
            escaped(text)
        );
    }
    out + "</table>\n"
}

fn shares(object: &PublishedObject) -> String {
    let parts = object.facts.shares.iter().filter(|part| part.share > 0.0);
    let row = |part: &super::Share| {
        format!(
            "<tr><th scope=\"row\">{}</th><td>{:.0} %</td><td>{:.2} mm</td></tr>\n",
            escaped(provenance_words(&part.provenance).unwrap_or(&part.provenance)),
            part.share * 100.0,
            part.mean_expected_error * 1e3
        )
    };
    let rows: String = parts.map(row).collect();
    if rows.is_empty() {
        return String::new();
    }
    format!(
        "<h2>Where the surface comes from</h2>\n<p>The expected error is the program's own estimate of the distance to the \
         true surface, not a measurement.</p>\n<table>\n<tr><th scope=\"col\">From</th><th scope=\"col\">Share</th>\
         <th scope=\"col\">Mean expected error</th></tr>\n{rows}</table>\n"
    )
}

fn notes(object: &PublishedObject) -> String {
    if object.facts.notes.is_empty() {
        return String::new();
    }
    let item = |note: &String| format!("<li dir=\"auto\">{}</li>\n", escaped(note));
    let items: String = object.facts.notes.iter().map(item).collect();
    format!("<h2>Notes</h2>\n<ul>\n{items}</ul>\n")
}

fn files(object: &PublishedObject, options: PageOptions<'_>) -> String {
    let mut out = "<h2>Files</h2>\n<ul>\n".to_owned();
    for level in &object.levels {
        let _ = writeln!(
            out,
            "<li><a href=\"{0}\" download>{0}</a> ({1})</li>",
            level.name,
            level_words(level)
        );
    }
    out += "<li><a href=\"scene.svx.json\">scene.svx.json</a> (Smithsonian Voyager)</li>\n";
    if options.has_manifests {
        out += "<li><a href=\"manifest.json\">manifest.json</a> (IIIF)</li>\n";
    }
    out + "</ul>\n"
}

#[cfg(test)]
mod tests {
    use super::super::testing::{HOSTILE, object};
    use super::*;

    const OPTIONS: PageOptions<'_> = PageOptions {
        title: "Cups",
        has_viewer: true,
        has_manifests: true,
    };

    /// The tags of a page, without what is in them but their names.
    fn tags(page: &str) -> Vec<&str> {
        let tags = page.split('<').skip(1);
        tags.map(|tag| tag.split([' ', '>', '\n']).next().unwrap_or_default())
            .collect()
    }

    #[test]
    fn no_text_of_a_recording_adds_a_tag_or_an_attribute() {
        let plain = object();
        let mut hostile = object();
        let about = &mut hostile.about;
        for text in [
            &mut about.subject,
            &mut about.title,
            &mut about.rights,
            &mut about.operator,
            &mut about.session,
            &mut about.captures,
        ] {
            *text = Some(HOSTILE.into());
        }
        about.capture = HOSTILE.into();
        about.time = HOSTILE.into();
        about.input_sha256 = HOSTILE.into();
        about.program = HOSTILE.into();
        hostile.facts.reasons[0].words = HOSTILE.into();
        hostile.facts.notes[0] = HOSTILE.into();
        let titled = PageOptions {
            title: HOSTILE,
            ..OPTIONS
        };
        let pages = |object: &PublishedObject, options| {
            [
                object_page(object, options),
                gallery(std::slice::from_ref(object), options),
            ]
        };
        for (plain, hostile) in pages(&plain, OPTIONS).iter().zip(&pages(&hostile, titled)) {
            assert_eq!(tags(plain), tags(hostile));
            let quotes = |page: &str| page.matches('"').count();
            assert_eq!(quotes(plain), quotes(hostile), "quotes end attributes");
            assert!(!hostile.contains(['\u{1b}', '\u{202e}']));
            assert!(hostile.contains("&lt;script&gt;"));
        }
    }

    #[test]
    fn nothing_on_a_page_is_from_elsewhere() {
        for page in [
            object_page(&object(), OPTIONS),
            gallery(&[object()], OPTIONS),
        ] {
            assert!(!page.contains("://"), "{page}");
            assert!(page.contains("default-src 'none'"));
            for part in page.split("<script").skip(1) {
                assert!(
                    part.starts_with(" type=\"module\" src=\"../../viewer.js\"></script>"),
                    "{part}"
                );
            }
            assert!(
                !page.contains(" style="),
                "the policy allows no style in a page"
            );
        }
    }

    #[test]
    fn a_page_without_a_viewer_has_a_picture_and_no_script() {
        let page = object_page(
            &object(),
            PageOptions {
                has_viewer: false,
                ..OPTIONS
            },
        );
        assert!(!page.contains("script type") && page.contains("picture.jpg"));
        assert!(page.contains("high.glb") && page.contains("80.0 × 60.0 × 100.0 mm"));
        assert!(page.contains("measured") || page.contains("silhouettes"));
    }
}
