//! The page. Which files make up the page? Plain HTML, CSS and ES modules, built into the program.

use axum::extract::Path;
use axum::http::header;
use axum::response::{IntoResponse, Response};

macro_rules! files {
    ($($name:literal: $kind:literal;)*) => {
        /// Every file but the index: name, media type, content.
        const FILES: &[(&str, &str, &str)] = &[$(($name, $kind, include_str!(concat!("../page/", $name))),)*];
    };
}

files! {
    "style.css": "text/css; charset=utf-8";
    "panels.css": "text/css; charset=utf-8";
    "icon.svg": "image/svg+xml";
    "main.js": "text/javascript; charset=utf-8";
    "memory.js": "text/javascript; charset=utf-8";
    "api.js": "text/javascript; charset=utf-8";
    "live.js": "text/javascript; charset=utf-8";
    "store.js": "text/javascript; charset=utf-8";
    "grid.js": "text/javascript; charset=utf-8";
    "camera.js": "text/javascript; charset=utf-8";
    "view.js": "text/javascript; charset=utf-8";
    "layers.js": "text/javascript; charset=utf-8";
    "tools.js": "text/javascript; charset=utf-8";
    "header.js": "text/javascript; charset=utf-8";
    "pen.js": "text/javascript; charset=utf-8";
    "polygon.js": "text/javascript; charset=utf-8";
    "draft.js": "text/javascript; charset=utf-8";
    "send.js": "text/javascript; charset=utf-8";
    "annotations.js": "text/javascript; charset=utf-8";
    "goals.js": "text/javascript; charset=utf-8";
    "tree.js": "text/javascript; charset=utf-8";
    "events.js": "text/javascript; charset=utf-8";
    "drive.js": "text/javascript; charset=utf-8";
    "plots.js": "text/javascript; charset=utf-8";
    "dom.js": "text/javascript; charset=utf-8";
}

/// The page itself.
const INDEX: &str = include_str!("../page/index.html");

pub(crate) async fn index() -> Response {
    ([(header::CONTENT_TYPE, "text/html; charset=utf-8")], INDEX).into_response()
}

pub(crate) async fn file(Path(name): Path<String>) -> Response {
    match FILES.iter().find(|(file, _, _)| *file == name) {
        Some((_, kind, content)) => ([(header::CONTENT_TYPE, *kind)], *content).into_response(),
        None => crate::http::no_such_file(&name),
    }
}
