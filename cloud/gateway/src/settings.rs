//! Settings of the gateway. Where does it listen, who may use it, and how much may they ask?

use std::path::PathBuf;

use zenav_protocol::settings;

settings! {
    /// The gateway.
    pub struct GatewaySettings {
        /// Address of the page and of the API. An address that other machines reach needs a token.
        pub listen: String = DEFAULT_LISTEN.to_owned();
        /// File whose first line is the bearer token that every request for data must carry; without it, whoever reaches the address may.
        pub token_file: Option<PathBuf> = None;
        /// Origins that may use the API from a browser besides the page itself, such as `https://robots.example.org`.
        pub origins: Vec<String> = Vec::new();
        /// Most frames a second to each browser (10: as often as a robot publishes its state).
        pub live_hz: f64 = 10.0, "Hz", 0.5..=30.0;
        /// Most browsers that are connected at the same time.
        pub max_clients: usize = 64, "", 1..=10_000;
        /// Most requests a second of all clients together; a stop is never counted (50: a person clicks once a second).
        pub requests_hz: f64 = 50.0, "Hz", 1.0..=10_000.0;
    }
}

/// Where the page is unless told otherwise.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:7480";
