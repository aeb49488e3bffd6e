//! Texels of all images in two texture arrays (one sRGB, one linear), and the slots that materials look up.

use crate::Result;
use crate::gpu::buffer::{TABLE_WIDTH, TableFormat};
use crate::gpu::{Gpu, Table};
use crate::scene::{ColourSpace, Filter, Material, Scene, TextureInfo, Wrap};

/// The tables behind `texture_slots`, `colour_texels` and `data_texels`.
pub struct GpuTextures {
    /// Three records a slot; see `shaders/lib/surface.wgsl`.
    pub slots: Table,
    /// sRGB texels, decoded by the device.
    pub colour: wgpu::TextureView,
    /// Linear texels.
    pub data: wgpu::TextureView,
    /// Bytes of texels on the device.
    pub bytes: u64,
}

/// Where the slots of a material are: index + 1, or 0 for none.
#[derive(Clone, Copy, Debug, Default)]
pub struct MaterialSlots {
    pub(super) base_colour: u32,
    pub(super) metallic_roughness: u32,
    pub(super) normal: u32,
    pub(super) emissive: u32,
    pub(super) specular: u32,
    pub(super) specular_colour: u32,
    pub(super) transmission: u32,
    pub(super) clearcoat: u32,
    pub(super) clearcoat_roughness: u32,
    pub(super) clearcoat_normal: u32,
    pub(super) anisotropy: u32,
    pub(super) sheen_colour: u32,
    pub(super) sheen_roughness: u32,
}

/// Records a slot.
pub(crate) const SLOT_RECORDS: u32 = 3;
/// Bits of a slot's flags, above two bits of wrap mode for each axis.
pub(crate) const NEAREST: u32 = 16;
pub(crate) const SRGB: u32 = 32;
pub(crate) const UV1: u32 = 64;

/// Side of a layer of texels.
const LAYER: u32 = TABLE_WIDTH;

impl GpuTextures {
    /// Uploads the textures of the scene that some material uses.
    ///
    /// # Errors
    /// As [`Gpu::table`]; a device has at most 2,048 layers of 16 Mtexel, which no scene that imports exceeds.
    pub fn new(gpu: &Gpu, scene: &Scene) -> Result<(GpuTextures, Vec<MaterialSlots>)> {
        let mut atlas = Atlas::default();
        let mut records: Vec<[u32; 4]> = Vec::new();
        let mut slot = |slot: &Option<TextureInfo>| -> u32 {
            let Some(slot) = slot else { return 0 };
            let texture = &scene.textures[slot.texture as usize];
            let image = &scene.images[texture.image as usize];
            let base = atlas.place(texture.image, texture.space, image.texels.len() as u32);
            let wrap = texture.wrap.map(|w| match w {
                Wrap::Repeat => 0,
                Wrap::Mirror => 1,
                Wrap::Clamp => 2,
            });
            let bit = |bit: u32, on: bool| if on { bit } else { 0 };
            records.push(slot.matrix.to_cols_array().map(f32::to_bits));
            let flags = wrap[0]
                | wrap[1] << 2
                | bit(NEAREST, texture.filter == Filter::Nearest)
                | bit(SRGB, texture.space == ColourSpace::Srgb)
                | bit(UV1, slot.uv_set == 1);
            records.push([slot.offset.x.to_bits(), slot.offset.y.to_bits(), flags, 0]);
            records.push([base, image.width, image.height, 0]);
            records.len() as u32 / SLOT_RECORDS
        };
        let slots = |m: &Material, slot: &mut dyn FnMut(&Option<TextureInfo>) -> u32| MaterialSlots {
            base_colour: slot(&m.base_colour_texture),
            metallic_roughness: slot(&m.metallic_roughness_texture),
            normal: slot(&m.normal_texture),
            emissive: slot(&m.emissive_texture),
            specular: slot(&m.specular_texture),
            specular_colour: slot(&m.specular_colour_texture),
            transmission: slot(&m.transmission_texture),
            clearcoat: slot(&m.clearcoat_texture),
            clearcoat_roughness: slot(&m.clearcoat_roughness_texture),
            clearcoat_normal: slot(&m.clearcoat_normal_texture),
            anisotropy: slot(&m.anisotropy_texture),
            sheen_colour: slot(&m.sheen_colour_texture),
            sheen_roughness: slot(&m.sheen_roughness_texture),
        };
        let materials = scene.materials.iter().map(|m| slots(m, &mut slot)).collect();
        let slots = gpu.table("penumbra/scene/texture_slots", &records, TableFormat::Uint)?;
        let colour = atlas.upload(gpu, scene, ColourSpace::Srgb);
        let data = atlas.upload(gpu, scene, ColourSpace::Linear);
        let bytes = u64::from(atlas.texels[0] + atlas.texels[1]) * 4;
        Ok((GpuTextures { slots, colour, data, bytes }, materials))
    }
}

/// Images one after the other, a list for each colour space.
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
