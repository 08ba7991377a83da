//! Pictures. Shapes by `tiny-skia`, letters of DejaVu Sans by `ab_glyph`, files by `png` and `gif`.
//!
//! | file | answers |
//! |---|---|
//! | `canvas` | how are shapes and text drawn into pixels? |
//! | `plane` | how is a part of the plane drawn? with title, legend, place names and a scale bar |
//! | `scene` | what did a robot know, plan and drive? a map with everything on it |
//! | `film` | how are pictures encoded as an animated GIF? |
//! | `terminal` | how is a map drawn in a terminal? half-block characters, with marks over it |
//! | `tree` | how is a behaviour tree drawn? as SVG or PNG |

pub mod canvas;
pub mod film;
pub mod plane;
pub mod scene;
pub mod terminal;
pub mod tree;
