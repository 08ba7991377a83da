//! Settings of the gateway. Where does it listen, who may use it, and how many requests may they send?

use std::path::PathBuf;

use zenav_protocol::settings;

settings! {
    /// The gateway.
    ///
    /// ```
    /// use zenav_gateway::{DEFAULT_LISTEN, GatewaySettings};
    /// use zenav_protocol::settings::Settings;
    ///
    /// let mut settings = GatewaySettings::default();
    /// assert_eq!(settings.listen, DEFAULT_LISTEN);
    /// settings.live_hz = 60.0;
    /// assert_eq!(settings.check().unwrap_err().to_string(), "`live_hz` is 60: expected 0.5 to 30 Hz");
    /// ```
    pub struct GatewaySettings {
        /// Address of the page and the API. An address reachable by other machines requires a token.
        pub listen: String = DEFAULT_LISTEN.to_owned();
        /// File whose first line is the bearer token that every request for data must carry; without it, everybody who reaches the address
        /// has access.
        pub token_file: Option<PathBuf> = None;
        /// Origins other than the page's own that may use the API from a browser, such as `https://robots.example.org`.
        pub origins: Vec<String> = Vec::new();
        /// Most frames per second to each browser (10: as often as a robot publishes its state).
        pub live_hz: f64 = 10.0, "Hz", 0.5..=30.0;
        /// Most browsers connected at the same time.
        pub max_clients: usize = 64, "", 1..=10_000;
        /// Most requests per second of all clients together; stops are not counted (50: a person clicks once a second).
        pub requests_hz: f64 = 50.0, "Hz", 1.0..=10_000.0;
    }
}

/// Default address of the page.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:7480";
