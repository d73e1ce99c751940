//! A panorama behind the scene on the adapter.

use half::f16;
use lightkiln_proto::relight::{Panorama, PanoramaImage};
use std::sync::Arc;
use wgpu::ShaderStages as Stages;

use super::pipelines::{Program, behind, render_pipeline};
use crate::error::Result;
use crate::passes::gpu::{Gpu, failed, texture, uniform};

/// The shader.
pub const PANORAMA_SHADER: &str = concat!(include_str!("view.wgsl"), include_str!("panorama.wgsl"));

/// Numbers of the shader; twin of `PanoramaNumbers`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PanoramaNumbers {
    /// Cosine and sine of its turn about the vertical.
    pub turn: [f32; 2],
    /// Factor on its texels.
    pub strength: f32,
    /// Nothing.
    pub pad: f32,
}

/// The pass of one panorama.
#[derive(Debug)]
pub(super) struct PanoramaPass {
    image: Arc<PanoramaImage>,
    numbers: wgpu::Buffer,
    pipeline: wgpu::RenderPipeline,
    group: wgpu::BindGroup,
}

impl PanoramaPass {
    /// Uploads a panorama; `view` is the buffer of the view. Errs where the adapter has no room for it.
    pub fn new(gpu: &Gpu, panorama: &Panorama, view: &wgpu::Buffer) -> Result<Self> {
        let image = Arc::clone(panorama.image());
        let picture = upload(gpu, &image)?;
        let kinds = [
            (Stages::VERTEX_FRAGMENT, uniform(false)),
            (Stages::FRAGMENT, uniform(false)),
            (
                Stages::FRAGMENT,
                texture(wgpu::TextureSampleType::Float { filterable: false }, wgpu::TextureViewDimension::D2),
            ),
        ];
        let layout = gpu.bind_layout(&kinds);
        let numbers = gpu.uniform("panorama", &numbers_of(panorama));
        let picture = picture.create_view(&wgpu::TextureViewDescriptor::default());
        let resources = [
            view.as_entire_binding(),
            numbers.as_entire_binding(),
            wgpu::BindingResource::TextureView(&picture),
        ];
        let group = gpu.bind(&layout, &resources);
        let module = gpu.module("panorama", PANORAMA_SHADER);
        let layout = gpu.pipeline_layout(&[&layout]);
        let primitive = wgpu::PrimitiveState::default();
        let sky = Program { module: &module, vertex: "sky_corner", fragment: "panorama_sky", constants: &[] };
        let pipeline = render_pipeline(gpu, &layout, sky, &[], primitive, (behind(), None));
        gpu.check()?;
        Ok(Self { image, numbers, pipeline, group })
    }

    /// It is of that picture.
    pub fn is_of(&self, panorama: &Panorama) -> bool {
        Arc::ptr_eq(&self.image, panorama.image())
    }

    /// Turns and scales the picture.
    pub fn set(&self, gpu: &Gpu, panorama: &Panorama) {
        gpu.write(&self.numbers, &[numbers_of(panorama)]);
    }

    /// Draws it behind everything.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn numbers_of(panorama: &Panorama) -> PanoramaNumbers {
    let strength = panorama.strength() * texel_scale(panorama.image());
    PanoramaNumbers { turn: panorama.turn(), strength, pad: 0.0 }
}

/// Radiance of a texel of 1: texels of a picture that is brighter than 16-bit numbers hold are divided by it.
fn texel_scale(image: &PanoramaImage) -> f32 {
    (image.brightest() / f16::MAX.to_f32()).max(1.0)
}

/// The picture in 16-bit numbers, over [`texel_scale`].
fn texels(image: &PanoramaImage) -> Vec<[u16; 4]> {
    let scale = texel_scale(image);
    // Rounding must not take the brightest one to infinity.
    let half = |value: f32| f16::from_f32((value / scale).min(f16::MAX.to_f32())).to_bits();
    image.pixels().iter().map(|[r, g, b]| [half(*r), half(*g), half(*b), half(scale)]).collect()
}

/// Uploads the picture; errs where it is larger than textures of the adapter.
fn upload(gpu: &Gpu, image: &PanoramaImage) -> Result<wgpu::Texture> {
    let [width, height] = image.size();
    let most = gpu.device.limits().max_texture_dimension_2d;
    if width.max(height) > most {
        return Err(failed(format!(
            "a panorama of {width} × {height} pixels is wider than the {most} of {}",
            gpu.name
        )));
    }
    let texels = texels(image);
    let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
    let texture = gpu.texture(&wgpu::TextureDescriptor {
        label: Some("panorama"),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba16Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })?;
    let layout = wgpu::TexelCopyBufferLayout {
        offset: 0,
        bytes_per_row: Some(width * size_of::<[u16; 4]>() as u32),
        rows_per_image: None,
    };
    gpu.queue.write_texture(texture.as_image_copy(), bytemuck::cast_slice(&texels), layout, size);
    Ok(texture)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suns_brighter_than_16_bit_numbers_keep_their_radiance() {
        for brightest in [1e6, 7e4, 3.0] {
            let pixels = vec![[brightest, 1.0, 0.02], [0.0; 3]];
            let image = Arc::new(PanoramaImage::new("test".into(), 2, 1, pixels.clone()).unwrap());
            let panorama = Panorama::new(Arc::clone(&image), 0.0, 2.5).unwrap();
            let strength = numbers_of(&panorama).strength;
            for (texel, pixel) in texels(&image).iter().zip(&pixels) {
                for (half, value) in texel.iter().zip(pixel) {
                    let found = strength * f16::from_bits(*half).to_f32();
                    let wanted = 2.5 * *value;
                    assert!((found - wanted).abs() <= 1e-3 * wanted, "{brightest}: {found}, wanted {wanted}");
                }
            }
        }
        // Nothing is lost of pictures that 16-bit numbers hold.
        let image = PanoramaImage::new("test".into(), 1, 1, vec![[6e4, 0.0, 0.0]]).unwrap();
        assert_eq!(texel_scale(&image), 1.0);
    }
}
