//! The features that kernels are composed of.

use crate::procedural::Functions;

kernel_kit::features! {
    /// Code that a kernel contains only if a scene, a setting or a device needs it. Kernels name a feature in snake
    /// case: `@if(visibility_map)`. The module [`crate::specialisation`] decides on each feature.
    pub enum Feature {
        /// Device: lookup tables are textures, which software devices read several times faster than storage buffers.
        TextureLoads,
        /// Device: tables that grow with the triangles exceed a texture or a buffer, and lie in layers.
        LayeredTexels,
        /// Device: two threads share a dispatch, so workgroups alternate between its halves.
        Interleave,
        /// Device: subgroups have eight lanes, which trace their rays together.
        Packets,
        /// Scene: the BVH is shallow, so a short traversal stack is enough.
        ShallowBvh,
        /// Scene: meshes are stored once and placed by instances.
        Instances,
        /// Scene: some triangle is so long and thin that barycentric weights round to a wrong distance.
        Needles,
        /// Scene: some material has a texture.
        Textures,
        /// Scene: some texture uses the second set of texture coordinates.
        Uv1,
        /// Scene: some vertex has a colour other than white.
        VertexColours,
        /// Scene: some material has a normal map.
        NormalMaps,
        /// Scene: some triangle has vertex normals that make it part of a smooth surface.
        SmoothNormals,
        /// Scene: some material is not Lambertian.
        Glossy,
        /// Scene: some material transmits light.
        Transmission,
        /// Scene: some material has a clear coat.
        Clearcoat,
        /// Scene: some clear coat has a normal map that its base does not have.
        CoatNormals,
        /// Scene: some material has an anisotropic specular lobe.
        Anisotropy,
        /// Scene: some material has a sheen lobe.
        Sheen,
        /// Scene: some material is iridescent.
        Iridescence,
        /// Scene: some material transmits light diffusely.
        DiffuseTransmission,
        /// Scene: some material refracts each wavelength its own way.
        Dispersion,
        /// Scene: some surface lies in the volume of another.
        Immersed,
        /// Scene: some material is alpha-masked or blended, so rays test the triangles that they hit.
        AlphaTest,
        /// Scene: some material is unlit.
        Unlit,
        /// Scene: some objects are functions, not meshes.
        Procedurals,
        /// Scene: some light is an emissive mesh.
        MeshLights,
        /// Scene: some light is a point light.
        PointLights,
        /// Scene: some light is a spot light.
        SpotLights,
        /// Scene: some light is directional.
        DirectionalLights,
        /// Scene: an environment map surrounds it.
        Environment,
        /// Scene: some mesh light has too many triangles to evaluate each of them at every point.
        ManyEmitters,
        /// Scene: some mesh light with many triangles is closed, so that about half of it faces away from any point.
        EmitterPairs,
        /// Scene: lights of many triangles are convex lamps, and no surface that reflects is near to one.
        FarEmitters,
        /// Scene: some mesh light has an emissive texture.
        EmissiveTextures,
        /// Scene: some mesh light is transparent in parts, which do not emit.
        EmissiveAlpha,
        /// Scene: some mesh light emits into a volume behind its surface, which absorbs its light.
        EmissiveVolumes,
        /// Camera: it has an iris, so that points out of focus are blurred.
        ThinLens,
        /// Setting: the camera does not see the environment.
        HiddenEnvironment,
        /// Setting: some pixels get more samples than others.
        AdaptiveSampling,
        /// Method: points that face away from a light are counted apart.
        DarkPoints,
        /// Method: photons classify the points.
        VisibilityMap,
        /// Method: photons carry the index of their light.
        LightTags,
        /// Method: photons are counted without regard to their normals, as in the paper.
        PaperCounting,
        /// Method: n_i and n_s of boundaries are counted exactly, because they are shown.
        ExactCounts,
        /// Method: where the map does not decide, the shadow rays of earlier samples are photons.
        FineCells,
        /// Output: which cells decide the points, for a window that shows them.
        ShownCells,
        /// Method: rays from the cells of a grid estimate the visibility of lights from the points in them.
        Cells,
        /// Method: a cell decides only if its neighbours agree with it.
        VoxelTags,
        /// Method: lists of the surfaces around each light show what may hide it.
        LightBuffer,
        /// Method: lights are tested in the order of their potential contribution.
        Ward,
        /// Method: points sample a few of many lights.
        LightSampling,
        /// Method: all lights are sampled with the same probability, not by power.
        UniformLightSampling,
        /// Method: lights are sampled by the light that each would send to the point if nothing were in between.
        ContributionSampling,
        /// Method: points sample the lights that reach their zone, according to photons.
        Zones,
        /// Method: some of the points that photons classify as lit or shadowed are audited.
        Audit,
        /// Method: few points need light points for shadows or highlights, because photons or cells classify most
        /// points; a queue holds them.
        FewSampled,
        /// Scene: some light has a closed form.
        ClosedForms,
        /// Scene: some light has no closed form, and light points take its place.
        SampledForms,
        /// Method: paths end at irradiance estimated from photons.
        GlobalMap,
        /// Method: the photon map is shown directly.
        PhotonMap,
        /// Method: shadow photons carry negative flux.
        NegativePhotons,
        /// Scene and method: camera rays follow specular chains through clear glass and mirrors.
        SpecularChains,
        /// Method: a photon map of its own holds caustics.
        Caustics,
        /// Method: irradiance points store the part of the irradiance that only focusing surfaces have scattered.
        CausticIrradiance,
        /// Method: irradiance records hold the diffuse part of indirect light.
        IrradianceCache,
        /// Method: paths carry indirect light, and another pass carries direct light.
        Indirect,
        /// Scene: some light is wider than a narrow lobe of some glossy surface, so that rays sampled from the BSDF
        /// complement light points.
        BsdfRays,
        /// Method: paths are single rays from the points where they may hit a light.
        Highlights,
        /// Method: visibility is estimated from photons or statistics, without shadow rays.
        VisibilityEstimate,
        /// Output: the albedo channels.
        AovAlbedo,
        /// Output: the normal channels.
        AovNormal,
        /// Output: the position and depth channels.
        AovPosition,
        /// Output: the shadow channels.
        AovShadow,
        /// Output: albedo, normals and positions that guide denoisers.
        Guides,
    }
}

/// The features that the kernels of a render are composed with, and the functions of its procedural objects.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Features {
    set: kernel_kit::Features<Feature>,
    functions: Functions,
}

impl Features {
    /// All features, and no functions.
    pub fn all() -> Self {
        Features { set: kernel_kit::Features::all(), functions: Functions::default() }
    }

    /// These features with `feature` on or off.
    #[must_use]
    pub fn with(mut self, feature: Feature, on: bool) -> Self {
        self.set.set(feature, on);
        self
    }

    /// Turns `feature` on or off.
    pub fn set(&mut self, feature: Feature, on: bool) {
        self.set.set(feature, on);
    }

    /// These features with the functions of procedural objects.
    #[must_use]
    pub fn with_functions(self, functions: Functions) -> Self {
        Features { functions, ..self }
    }

    /// Whether `feature` is on.
    pub fn has(&self, feature: Feature) -> bool {
        self.set.has(feature)
    }

    /// The features that are on, in the order of [`Feature`].
    pub fn iter(&self) -> impl Iterator<Item = Feature> + '_ {
        self.set.iter()
    }

    /// The features as the kit takes them.
    pub fn kit(&self) -> &kernel_kit::Features<Feature> {
        &self.set
    }

    /// The functions of procedural objects.
    pub fn functions(&self) -> &Functions {
        &self.functions
    }
}
