//! Access. May this request use the gateway?
//!
//! - With a token: every request that carries it, in `Authorization: Bearer …` or, for a WebSocket in a browser, as the subprotocol
//!   `bearer.…`.
//! - Without one the gateway listens on loopback only, and the `Host` must be a loopback name: this keeps out a page of another site whose
//!   name was made to point here (DNS rebinding).
//! - A browser's request for a page carries the page's origin: it must be the gateway's own, or one named in the settings.

use std::net::{IpAddr, SocketAddr};

/// Who may use the gateway.
#[derive(Clone, Default)]
pub struct Access {
    token: Option<String>,
    origins: Vec<String>,
}

impl std::fmt::Debug for Access {
    /// Without the token, which belongs in no log.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut shown = f.debug_struct("Access");
        shown.field("origins", &self.origins).finish_non_exhaustive()
    }
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Denied {
    /// The token is missing or wrong.
    Token,
    /// The request comes from a page of another origin.
    Origin,
    /// The request addresses the gateway by a name other than loopback's.
    Host,
}

/// Shortest token, bytes.
const SHORTEST_TOKEN: usize = 16;

impl Access {
    /// Checks that the gateway may listen on an address with this token.
    ///
    /// ```
    /// use zenav_gateway::Access;
    ///
    /// assert!(Access::new("127.0.0.1:7480".parse()?, None, Vec::new()).is_ok());
    /// let refused = Access::new("0.0.0.0:7480".parse()?, None, Vec::new()).unwrap_err();
    /// assert!(refused.starts_with("0.0.0.0:7480 can be reached by other machines"), "{refused}");
    /// # Ok::<(), std::net::AddrParseError>(())
    /// ```
    ///
    /// # Errors
    /// A sentence: the address is reachable by other machines and there is no token, or the token or an origin is invalid.
    pub fn new(listen: SocketAddr, token: Option<String>, origins: Vec<String>) -> Result<Self, String> {
        match &token {
            None if !listen.ip().is_loopback() => Err(format!(
                "{listen} can be reached by other machines, which could then drive the robots: expected a token (`--token-file FILE`, `[gateway] token_file`)"
            )),
            Some(token) if token.len() < SHORTEST_TOKEN || !token.bytes().all(is_token) => Err(format!(
                "the token: expected at least {SHORTEST_TOKEN} letters, digits or signs of !#$%&'*+-.^_`|~ (a browser offers no others for a \
                 WebSocket)"
            )),
            _ => match origins.iter().find(|origin| !is_origin(origin)) {
                Some(origin) => Err(format!(
                    "`[gateway] origins`: {origin:?}: expected a scheme and a host, such as `https://robots.example.org`"
                )),
                None => Ok(Self { token, origins }),
            },
        }
    }

    /// Whether a request for the page may pass; the page holds no data.
    pub(crate) fn admit_page(&self, host: Option<&str>) -> Result<(), Denied> {
        if self.token.is_none() && !host.is_some_and(is_loopback_host) {
            return Err(Denied::Host);
        }
        Ok(())
    }

    /// Whether a request for data or an action may pass, by its `Host`, its `Origin`, and its token.
    ///
    /// ```
    /// use zenav_gateway::{Access, Denied};
    ///
    /// let (host, token) = (Some("robots.lan:7480"), Some("0123456789abcdef"));
    /// let access = Access::new("0.0.0.0:7480".parse().unwrap(), token.map(str::to_owned), Vec::new())?;
    /// assert_eq!(access.admit(host, None, token), Ok(()));
    /// assert_eq!(access.admit(host, None, None), Err(Denied::Token));
    /// assert_eq!(access.admit(host, Some("https://evil.example"), token), Err(Denied::Origin));
    /// # Ok::<(), String>(())
    /// ```
    ///
    /// # Errors
    /// Which of the three is refused.
    pub fn admit(&self, host: Option<&str>, origin: Option<&str>, token: Option<&str>) -> Result<(), Denied> {
        self.admit_page(host)?;
        if let Some(origin) = origin
            && !self.is_own(origin, host)
        {
            return Err(Denied::Origin);
        }
        match (&self.token, token) {
            (None, _) => Ok(()),
            (Some(wanted), Some(token)) if equal(wanted.as_bytes(), token.as_bytes()) => Ok(()),
            (Some(_), _) => Err(Denied::Token),
        }
    }

    fn is_own(&self, origin: &str, host: Option<&str>) -> bool {
        let named = self.origins.iter().any(|named| named.eq_ignore_ascii_case(origin));
        let address = origin
            .strip_prefix("http://")
            .or_else(|| origin.strip_prefix("https://"));
        named || (address.is_some() && address == host)
    }
}

/// Whether a browser accepts this character in the name of a WebSocket's subprotocol, which carries the token (RFC 9110, section 5.6.2).
fn is_token(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || b"!#$%&'*+-.^_`|~".contains(&byte)
}

/// Whether a browser could tell this origin: a scheme and a host, and a port if it is not the scheme's own.
fn is_origin(text: &str) -> bool {
    let host = text.split_once("://").map(|(_, host)| host);
    host.is_some_and(|host| !host.is_empty() && !host.contains(['/', '?', '#', '@', ' ']))
}

/// Whether a `Host` header names loopback: a loopback address, or `localhost`.
fn is_loopback_host(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name == "localhost" || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// Constant-time comparison: the duration does not reveal where two texts differ.
fn equal(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOOPBACK: &str = "127.0.0.1:7480";
    const OPEN: &str = "0.0.0.0:7480";
    const TOKEN: &str = "0123456789abcdef";

    fn access(listen: &str, token: Option<&str>) -> Result<Access, String> {
        Access::new(
            listen.parse().unwrap(),
            token.map(str::to_owned),
            vec!["https://fleet.example".to_owned()],
        )
    }

    #[test]
    fn an_address_that_others_reach_needs_a_token_of_some_length() {
        assert!(access(LOOPBACK, None).is_ok() && access("[::1]:1", None).is_ok());
        assert!(access(OPEN, None).unwrap_err().contains("token"));
        assert!(access(OPEN, Some("short")).is_err() && access(OPEN, Some(TOKEN)).is_ok());
        assert!(
            access(OPEN, Some("abcdefghij/lmnopqrst")).is_err(),
            "no browser could offer it"
        );
    }

    #[test]
    fn an_origin_that_no_browser_tells_is_refused_at_once() {
        let with = |origin: &str| Access::new(LOOPBACK.parse().unwrap(), None, vec![origin.to_owned()]);
        for wrong in ["https://robots.lan/", "robots.lan", "https://", "https://a/b", ""] {
            assert!(
                with(wrong).unwrap_err().contains("expected a scheme and a host"),
                "{wrong}"
            );
        }
        let access = with("https://Robots.lan:8443").unwrap();
        let told = Some("https://robots.lan:8443");
        assert_eq!(
            access.admit(Some(LOOPBACK), told, None),
            Ok(()),
            "browsers tell it in small letters"
        );
    }

    #[test]
    fn on_loopback_a_page_of_another_site_and_a_rebound_name_are_turned_away() {
        let access = access(LOOPBACK, None).unwrap();
        let host = Some("localhost:7480");
        assert_eq!(access.admit(host, None, None), Ok(()));
        assert_eq!(access.admit(host, Some("http://localhost:7480"), None), Ok(()));
        assert_eq!(access.admit(Some("[::1]:7480"), None, None), Ok(()));
        assert_eq!(access.admit(host, Some("https://fleet.example"), None), Ok(()));
        assert_eq!(
            access.admit(host, Some("http://evil.example"), None),
            Err(Denied::Origin)
        );
        assert_eq!(
            access.admit(host, Some("http://localhost:9999"), None),
            Err(Denied::Origin)
        );
        assert_eq!(access.admit(host, Some("null"), None), Err(Denied::Origin));
        assert_eq!(
            access.admit(Some("evil.example:7480"), Some("http://evil.example:7480"), None),
            Err(Denied::Host)
        );
        assert_eq!(access.admit(None, None, None), Err(Denied::Host));
    }

    #[test]
    fn with_a_token_nothing_passes_without_it() {
        let access = access(OPEN, Some(TOKEN)).unwrap();
        let host = Some("robots.lan:7480");
        assert!(!format!("{access:?}").contains(TOKEN), "it belongs in no log");
        assert_eq!(access.admit_page(host), Ok(()));
        assert_eq!(access.admit(host, None, None), Err(Denied::Token));
        assert_eq!(access.admit(host, None, Some("0123456789abcdeg")), Err(Denied::Token));
        assert_eq!(access.admit(host, None, Some(TOKEN)), Ok(()));
        assert_eq!(
            access.admit(host, Some("http://evil.example"), Some(TOKEN)),
            Err(Denied::Origin)
        );
    }
}
