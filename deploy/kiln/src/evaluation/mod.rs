//! A bundle held against the path tracer, alone and with objects in it: its scene, the measurement, limits, tables and pages.

pub mod amid;
mod arguments;
mod dump;
mod flip;
mod gallery;
mod heat;
mod html;
mod limits;
mod measure;
mod objects;
mod pictures;
mod pixels;
mod scene;
mod shadows;
mod table;

pub use arguments::EvaluationArguments;
pub use dump::{write_dump, write_pixels};
pub use gallery::{FOLDER as GALLERY_FOLDER, Gallery, LIST as GALLERY_LIST};
pub use html::{FIGURES, PAGE, write_page};
pub use limits::check;
pub use measure::measure;
pub use objects::{Wanted, check_objects, evaluate, object_words, write_objects};
pub use pictures::draw;
pub use scene::{NotedScene, packed_scene_of_bundle, part_of_bundle};
pub use table::{Evaluation, words};
