//! Pictures. How is something drawn? Shapes by `tiny-skia`, letters of DejaVu Sans by `ab_glyph`, files by `png` and `gif`.
//!
//! | file | answers |
//! |---|---|
//! | `canvas` | how do shapes and words become pixels? |
//! | `plane` | how is a part of the plane drawn? With title, legend, place names and a scale bar |
//! | `scene` | what did a robot know, plan and drive? A map with everything on it |
//! | `film` | how do pictures become an animated GIF? |
//! | `terminal` | how does a map look in a terminal? Half-block characters, with marks over it |
//! | `tree` | how does a behaviour tree look on paper? As SVG or PNG |

pub mod canvas;
pub mod film;
pub mod plane;
pub mod scene;
pub mod terminal;
pub mod tree;
