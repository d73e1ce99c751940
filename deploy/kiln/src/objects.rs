//! Objects beside a bake: files that the command line names, and where they stand.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use lightkiln_client::bake::{Beside, ClientKinds, LoadedBake};
use lightkiln_client::fetch::Source;
use lightkiln_client::scene::{Object, ObjectShape, Stance, Texture};
use lightkiln_proto::content::Draw;
use lightkiln_proto::words::{object_from_text, stance_to_text};
use lightkiln_worker::objects::ObjectFile;
use lightkiln_worker::scene::{Bundle, Limits};

use crate::console::say;
use crate::failure::{Failure, Result};

/// A file of an object, and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectArgument {
    file: PathBuf,
    /// Its stance, where no key of a path says another.
    pub stance: Stance,
}

/// Reads `FILE pos=x,y,z turn=yaw,pitch,roll scale=s time=seconds clip=n swing=yaw,pitch,roll hinge=x,y,z`.
pub fn parse_object(text: &str) -> std::result::Result<ObjectArgument, String> {
    let (file, stance) = object_from_text(text).map_err(|error| error.to_string())?;
    Ok(ObjectArgument { file: file.into(), stance })
}

impl ObjectArgument {
    /// That of a file at a place.
    pub fn new(file: PathBuf, stance: Stance) -> Self {
        Self { file, stance }
    }

    /// The file, or the folder of its bundle.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Words of a command line that [`parse_object`] reads as that object.
    pub fn words(&self) -> String {
        format!("{} {}", self.file.display(), stance_to_text(&self.stance)).trim_end().to_owned()
    }

    /// Reads the file, or the bundle of an object's own bake.
    pub fn beside(&self, kinds: &ClientKinds) -> Result<Beside> {
        if !self.file.is_dir() {
            return Ok(Beside::Meshes(self.read()?));
        }
        let bake = Arc::new(LoadedBake::load(&Source::bundle(&self.file)?, kinds)?);
        Ok(Beside::Baked { name: self.file.display().to_string(), bake })
    }

    /// Reads the file; says on standard error what of it is not honoured.
    pub fn read(&self) -> Result<Object> {
        let file = self.file.display();
        let refused = |error: &(dyn Error + 'static)| {
            Failure::bad_input(format!("the object {file} cannot be read")).caused_by(error)
        };
        let limits = Limits::default();
        let packed = Bundle::pack_path(&self.file, &limits).map_err(|error| refused(&error))?;
        let opened = Bundle::from_bytes(packed, &limits).and_then(ObjectFile::open);
        let (object, warnings) = opened.map_err(|error| refused(&error))?;
        for warning in warnings {
            say!("warning: {file}: {}", warning.message);
        }
        let mut textures = Vec::new();
        for image in object.images() {
            textures.push(Texture::decode(&image.bytes).map_err(|error| refused(&error))?);
        }
        let (name, materials) = (self.file.display().to_string(), object.materials());
        let shape = Arc::new(FileShape { file: object, last: Mutex::default() });
        Ok(Object { name, materials, textures, shape })
    }
}

/// Meshes by animation and time.
type Frozen = Option<(u32, f32, Vec<Draw>)>;

/// Meshes of a file.
#[derive(Debug)]
struct FileShape {
    file: ObjectFile,
    /// The last meshes asked for: most objects play nothing.
    last: Mutex<Frozen>,
}

impl ObjectShape for FileShape {
    fn draws(&self, clip: u32, time_s: f32) -> std::result::Result<Vec<Draw>, Box<dyn Error + Send + Sync>> {
        let clips = self.file.lengths_s().len();
        if clip > 0 && clip as usize >= clips {
            return Err(
                format!("clip={} is asked for, and the file has {clips} animation(s)", clip + 1).into()
            );
        }
        // Without animations all times are one.
        let time_s = if clips == 0 { 0.0 } else { time_s };
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((.., draws)) = last.as_ref().filter(|(at, time, _)| (*at, *time) == (clip, time_s)) {
            return Ok(draws.clone());
        }
        let draws = self.file.draws((clips > 0).then_some(clip as usize), time_s)?;
        *last = Some((clip, time_s, draws.clone()));
        Ok(draws)
    }

    fn length_s(&self, clip: u32) -> f32 {
        self.file.lengths_s().get(clip as usize).copied().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_read_with_their_animations_and_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a lift.gltf");
        std::fs::write(&file, lift().to_string()).unwrap();
        let argument = parse_object(&format!("{} pos=1,0,0", file.display())).unwrap();
        assert_eq!(argument.stance.position_m, [1.0, 0.0, 0.0]);
        let object = argument.read().unwrap();
        assert!(object.name.ends_with("a lift.gltf") && object.materials.len() == 1, "{object:?}");
        let height = |time_s| object.shape.draws(0, time_s).unwrap()[0].position_m[0][1];
        assert_eq!([0.0, 1.0, 1.0, 2.0].map(height), [0.0, 1.5, 1.5, 3.0]);
        assert_eq!([0, 1].map(|clip| object.shape.length_s(clip)), [2.0, 0.0]);
        let error = object.shape.draws(1, 0.0).unwrap_err().to_string();
        assert!(error.contains("clip=2") && error.contains("1 animation"), "{error}");
        let absent = parse_object(&folder.path().join("no.glb").display().to_string()).unwrap();
        assert!(absent.read().unwrap_err().to_string().contains("no.glb"));
        std::fs::write(&file, b"glTF").unwrap();
        assert!(argument.read().unwrap_err().to_string().contains("cannot be read"));
    }

    /// A triangle that rises by 3 m in 2 s.
    fn lift() -> serde_json::Value {
        let floats: Vec<f32> =
            vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0];
        let bytes: Vec<u8> = floats.iter().flat_map(|float| float.to_le_bytes()).collect();
        let text: String = bytes.iter().map(|byte| format!("%{byte:02x}")).collect();
        let view = |offset: usize, length: usize| serde_json::json!({"buffer": 0, "byteOffset": 4 * offset, "byteLength": 4 * length});
        let accessor = |view: usize, count: usize, kind: &str| serde_json::json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind});
        serde_json::json!({
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "buffers": [{"byteLength": bytes.len(), "uri": format!("data:application/octet-stream,{text}")}],
            "bufferViews": [view(0, 9), view(9, 2), view(11, 6)],
            "accessors": [accessor(0, 3, "VEC3"), accessor(1, 2, "SCALAR"), accessor(2, 2, "VEC3")],
            "animations": [{
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
                "samplers": [{"input": 1, "output": 2}],
            }],
        })
    }
}
