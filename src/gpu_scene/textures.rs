//! Texels of all images in two texture arrays (one sRGB, one linear), and the texture infos of materials.

use kernel_kit::{Gpu, TABLE_WIDTH, Table, TableFormat};

use crate::Result;
use crate::kernels::scene_texels::{TEXTURE_INFO_TEXELS, TEXTURE_NEAREST, TEXTURE_SRGB, TEXTURE_UV1};
use crate::scene::{ColourSpace, Filter, Material, Scene, TEXTURE_USES, TextureInfo, Wrap};

/// The tables behind `texture_infos`, `colour_texels` and `data_texels`.
pub struct GpuTextures {
    /// Three texels per texture info; see `shaders/lib/texture.wgsl`.
    pub infos: Table,
    /// sRGB texels, decoded by the device.
    pub colour: wgpu::TextureView,
    /// Linear texels.
    pub data: wgpu::TextureView,
    /// Bytes of texels on the device.
    pub bytes: u64,
}

/// For each use of a texture that a material may have, the number of its texture info (counted from 1), or 0 for none.
pub type MaterialTextures = [u32; TEXTURE_USES];

/// Side of a layer of texels.
const LAYER: u32 = TABLE_WIDTH;

impl GpuTextures {
    /// Uploads the textures of the scene that some material uses.
    ///
    /// # Errors
    /// As [`Gpu::table`]; a device has at most 2,048 layers of 16 Mtexel, which no scene that imports exceeds.
    pub fn new(gpu: &Gpu, scene: &Scene) -> Result<(GpuTextures, Vec<MaterialTextures>)> {
        let mut atlas = Atlas::default();
        let mut texels: Vec<[u32; 4]> = Vec::new();
        let mut push = |info: &TextureInfo| {
            texels.extend(info_texels(scene, &mut atlas, info));
            texels.len() as u32 / TEXTURE_INFO_TEXELS
        };
        let mut numbers = |material: &Material| {
            let mut numbers = [0; TEXTURE_USES];
            for (number, info) in numbers.iter_mut().zip(material.texture_uses()) {
                *number = info.as_ref().map_or(0, &mut push);
            }
            numbers
        };
        let materials = scene.materials.iter().map(&mut numbers).collect();
        let infos = gpu.table("penumbra/scene/texture_infos", &texels, TableFormat::Uint)?;
        let colour = atlas.upload(gpu, scene, ColourSpace::Srgb);
        let data = atlas.upload(gpu, scene, ColourSpace::Linear);
        let bytes = u64::from(atlas.texels[0] + atlas.texels[1]) * 4;
        Ok((GpuTextures { infos, colour, data, bytes }, materials))
    }
}

fn info_texels(scene: &Scene, atlas: &mut Atlas, info: &TextureInfo) -> [[u32; 4]; TEXTURE_INFO_TEXELS as usize] {
    let texture = &scene.textures[info.texture as usize];
    let image = &scene.images[texture.image as usize];
    let base = atlas.place(texture.image, texture.space, image.texels.len() as u32);
    let wrap = texture.wrap.map(|w| match w {
        Wrap::Repeat => 0,
        Wrap::Mirror => 1,
        Wrap::Clamp => 2,
    });
    let bit = |bit: u32, on: bool| if on { bit } else { 0 };
    let flags = wrap[0]
        | wrap[1] << 2
        | bit(TEXTURE_NEAREST, texture.filter == Filter::Nearest)
        | bit(TEXTURE_SRGB, texture.space == ColourSpace::Srgb)
        | bit(TEXTURE_UV1, info.uv_set == 1);
    [
        info.matrix.to_cols_array().map(f32::to_bits),
        [info.offset.x.to_bits(), info.offset.y.to_bits(), flags, 0],
        [base, image.width, image.height, 0],
    ]
}

/// The images in sequence, in a list for each colour space.
#[derive(Default)]
struct Atlas {
    placed: Vec<(u32, ColourSpace, u32)>,
    texels: [u32; 2],
}

impl Atlas {
    fn place(&mut self, image: u32, space: ColourSpace, texels: u32) -> u32 {
        if let Some(found) = self.placed.iter().find(|p| (p.0, p.1) == (image, space)) {
            return found.2;
        }
        let used = &mut self.texels[usize::from(space == ColourSpace::Linear)];
        let base = *used;
        self.placed.push((image, space, base));
        *used += texels;
        base
    }

    fn upload(&self, gpu: &Gpu, scene: &Scene, space: ColourSpace) -> wgpu::TextureView {
        let texels = self.texels[usize::from(space == ColourSpace::Linear)];
        let layers = texels.div_ceil(LAYER * LAYER).max(1);
        let rows = if layers > 1 { LAYER } else { texels.div_ceil(LAYER).max(1) };
        let size = wgpu::Extent3d { width: LAYER, height: rows, depth_or_array_layers: layers };
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("penumbra/scene/texels"),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: match space {
                ColourSpace::Srgb => wgpu::TextureFormat::Rgba8UnormSrgb,
                ColourSpace::Linear => wgpu::TextureFormat::Rgba8Unorm,
            },
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let mut bytes: Vec<u8> = Vec::with_capacity(texels as usize * 4);
        for (image, _, _) in self.placed.iter().filter(|p| p.1 == space) {
            bytes.extend_from_slice(bytemuck::cast_slice(&scene.images[*image as usize].texels));
        }
        bytes.resize((LAYER * rows * layers) as usize * 4, 0);
        gpu.queue.write_texture(
            texture.as_image_copy(),
            &bytes,
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(LAYER * 4), rows_per_image: Some(rows) },
            size,
        );
        texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        })
    }
}
