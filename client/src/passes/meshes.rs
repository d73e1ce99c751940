//! Meshes and textures of a scene on the adapter, shared by the shadow and the shade pass.

use lightkiln_proto::manifest::{TextureUse, Wrap};
use wgpu::{ShaderStages as Stages, TextureViewDimension as Dimension};

use super::gpu::{Gpu, failed, texture};
use crate::error::Result;
use crate::scene::{Encoding, LoadedDraw, LoadedScene, Texture, Vertex};

/// A mesh's buffers.
#[derive(Debug)]
pub(in crate::passes) struct Mesh {
    pub vertices: wgpu::Buffer,
    pub indices: wgpu::Buffer,
    pub index_count: u32,
    pub material: usize,
}

/// Meshes, textures and samplers.
#[derive(Debug)]
pub struct Meshes {
    pub(in crate::passes) meshes: Vec<Mesh>,
    views: Vec<wgpu::TextureView>,
    white: wgpu::TextureView,
    /// By wrap of u and v: `samplers[3·u + v]`.
    samplers: Vec<wgpu::Sampler>,
}

/// Attributes of [`Vertex`].
pub(in crate::passes) const ATTRIBUTES: [wgpu::VertexAttribute; 5] = wgpu::vertex_attr_array![
    0 => Float32x3, 1 => Float32x3, 2 => Float32x2, 3 => Float32x4, 4 => Float32x2
];

/// Layout of [`Vertex`].
pub(in crate::passes) fn vertex_layout() -> wgpu::VertexBufferLayout<'static> {
    wgpu::VertexBufferLayout {
        array_stride: size_of::<Vertex>() as u64,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &ATTRIBUTES,
    }
}

/// Kinds of binding of a texture and its sampler.
pub(in crate::passes) fn sampled() -> [(Stages, wgpu::BindingType); 2] {
    let sample_type = wgpu::TextureSampleType::Float { filterable: true };
    let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
    [(Stages::FRAGMENT, texture(sample_type, Dimension::D2)), (Stages::FRAGMENT, sampler)]
}

/// 2×3 map from uv to a texture's coordinates as two padded rows.
pub(in crate::passes) fn uv_rows(used: Option<&TextureUse>) -> [[f32; 4]; 2] {
    let rows = used.and_then(|used| used.transform).unwrap_or([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    rows.map(|row| [row[0], row[1], row[2], 0.0])
}

impl Meshes {
    /// Uploads meshes and textures.
    pub fn new(gpu: &Gpu, scene: &LoadedScene) -> Result<Self> {
        let mut meshes = Vec::new();
        for draw in &scene.draws.draws {
            let (vertex_bytes, index_bytes) =
                (size_of_val(&draw.vertices[..]), size_of_val(&draw.triangles[..]));
            if vertex_bytes.max(index_bytes) as u64 > gpu.device.limits().max_buffer_size {
                let problem =
                    format!("a mesh takes {vertex_bytes} bytes, more than a buffer of {}", gpu.name);
                return Err(failed(problem));
            }
            let vertices = gpu.array("vertices", vertex_bytes as u64, wgpu::BufferUsages::VERTEX)?;
            let indices = gpu.array("indices", index_bytes as u64, wgpu::BufferUsages::INDEX)?;
            gpu.write(&vertices, &draw.vertices);
            gpu.write(&indices, &draw.triangles);
            let index_count = 3 * draw.triangles.len() as u32;
            meshes.push(Mesh { vertices, indices, index_count, material: draw.material as usize });
        }
        let views = scene.textures.iter().map(|texture| upload(gpu, texture)).collect::<Result<_>>()?;
        let white = upload(gpu, &Texture::new(1, 1, vec![[255; 4]]))?;
        let wraps = [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror];
        let pairs = wraps.into_iter().flat_map(|u| wraps.map(|v| [u, v]));
        let samplers = pairs.map(|wrap| sampler(gpu, wrap)).collect();
        Ok(Self { meshes, views, white, samplers })
    }

    /// Writes the vertices and triangles of a mesh, which are as many as before.
    pub(in crate::passes) fn set(&self, gpu: &Gpu, index: usize, draw: &LoadedDraw) {
        gpu.write(&self.meshes[index].vertices, &draw.vertices);
        gpu.write(&self.meshes[index].indices, &draw.triangles);
    }

    /// Texture and sampler of a use; white where there is none.
    pub(in crate::passes) fn texture(&self, used: Option<&TextureUse>) -> [wgpu::BindingResource<'_>; 2] {
        let index = |wrap: Wrap| match wrap {
            Wrap::Repeat => 0,
            Wrap::Clamp => 1,
            Wrap::Mirror => 2,
        };
        let (view, wrap) = match used {
            Some(used) => (&self.views[used.texture as usize], used.wrap),
            None => (&self.white, [Wrap::Clamp; 2]),
        };
        let sampler = &self.samplers[3 * index(wrap[0]) + index(wrap[1])];
        [wgpu::BindingResource::TextureView(view), wgpu::BindingResource::Sampler(sampler)]
    }

    /// Draws one mesh with the pipeline and groups that are bound.
    pub(in crate::passes) fn draw(&self, pass: &mut wgpu::RenderPass<'_>, mesh: &Mesh) {
        if mesh.index_count == 0 {
            return;
        }
        pass.set_vertex_buffer(0, mesh.vertices.slice(..));
        pass.set_index_buffer(mesh.indices.slice(..), wgpu::IndexFormat::Uint32);
        pass.draw_indexed(0..mesh.index_count, 0, 0..1);
    }
}

fn sampler(gpu: &Gpu, wrap: [Wrap; 2]) -> wgpu::Sampler {
    let mode = |wrap: Wrap| match wrap {
        Wrap::Repeat => wgpu::AddressMode::Repeat,
        Wrap::Clamp => wgpu::AddressMode::ClampToEdge,
        Wrap::Mirror => wgpu::AddressMode::MirrorRepeat,
    };
    gpu.sampler(&wgpu::SamplerDescriptor {
        address_mode_u: mode(wrap[0]),
        address_mode_v: mode(wrap[1]),
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        mipmap_filter: wgpu::MipmapFilterMode::Linear,
        ..Default::default()
    })
}

fn upload(gpu: &Gpu, texture: &Texture) -> Result<wgpu::TextureView> {
    let finest = &texture.levels[0];
    let longest = gpu.device.limits().max_texture_dimension_2d;
    if finest.width.max(finest.height) > longest {
        let problem =
            format!("a texture is {} × {}, {} takes {longest}", finest.width, finest.height, gpu.name);
        return Err(failed(problem));
    }
    let extent = |width, height| wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
    let uploaded = gpu.texture(&wgpu::TextureDescriptor {
        label: Some("texture"),
        size: extent(finest.width, finest.height),
        mip_level_count: texture.levels.len() as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: match texture.encoding {
            Encoding::Colour => wgpu::TextureFormat::Rgba8UnormSrgb,
            Encoding::Numbers => wgpu::TextureFormat::Rgba8Unorm,
        },
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })?;
    for (mip_level, level) in texture.levels.iter().enumerate() {
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(4 * level.width),
            rows_per_image: Some(level.height),
        };
        let target = wgpu::TexelCopyTextureInfo {
            texture: &uploaded,
            mip_level: mip_level as u32,
            origin: wgpu::Origin3d::ZERO,
            aspect: wgpu::TextureAspect::All,
        };
        let bytes = bytemuck::cast_slice(&level.texels);
        gpu.queue.write_texture(target, bytes, layout, extent(level.width, level.height));
    }
    Ok(uploaded.create_view(&wgpu::TextureViewDescriptor::default()))
}
