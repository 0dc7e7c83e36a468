//! The names under which browsers reach the page. A request with another `Host` is refused, so that a foreign name that
//! was made to resolve to this computer reaches nothing.

/// One way to reach the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Origin {
    /// As a browser sends it in `Origin`: `https://rig.example`.
    pub(super) text: String,
    /// As a browser sends it in `Host`: `rig.example`.
    pub(super) authority: String,
    /// Whether it is reached with TLS.
    pub(super) tls: bool,
}

/// All ways to reach the page; at least one.
#[derive(Clone, Debug)]
pub(super) struct Origins(Vec<Origin>);

impl Origins {
    /// Reads origins. Refuses what is not an origin, and one of the network without TLS; the error says why.
    pub(super) fn parse(texts: &[String]) -> Result<Self, String> {
        let origins: Result<Vec<_>, _> = texts.iter().map(|text| parse(text)).collect();
        Ok(Self(origins?))
    }

    /// The origin that a `Host` header names.
    pub(super) fn of_host(&self, host: &str) -> Option<&Origin> {
        let mut origins = self.0.iter();
        origins.find(|origin| origin.authority.eq_ignore_ascii_case(host))
    }

    /// The origin that a link for people names: one with TLS if there is one, for that is how others reach the page.
    pub(super) fn for_links(&self) -> Option<&Origin> {
        let with_tls = self.0.iter().find(|origin| origin.tls);
        with_tls.or_else(|| self.0.first())
    }
}

fn parse(text: &str) -> Result<Origin, String> {
    let wrong =
        || format!("found {text:?}, expected a scheme and a host, such as https://rig.example");
    let (scheme, authority) = text.split_once("://").ok_or_else(wrong)?;
    let tls = match scheme {
        "https" => true,
        "http" => false,
        _ => return Err(wrong()),
    };
    let is_fine = |c: char| c.is_ascii_alphanumeric() || ".-:[]".contains(c);
    if authority.is_empty() || !authority.chars().all(is_fine) {
        return Err(wrong());
    }
    let host = match authority.rsplit_once(':') {
        Some((host, port)) if port.bytes().all(|b| b.is_ascii_digit()) => host,
        _ => authority,
    };
    if !tls && !["localhost", "127.0.0.1", "[::1]"].contains(&host) {
        return Err(format!(
            "{text:?} has no TLS: expected https, or http with localhost, 127.0.0.1 or [::1]"
        ));
    }
    Ok(Origin {
        text: text.to_ascii_lowercase(),
        authority: authority.to_ascii_lowercase(),
        tls,
    })
}
