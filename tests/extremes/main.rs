//! Extreme cases, by whole renders through import and library. The expected result is an invariant or a closed form.
//! Some tests measure the families of `penumbra stress` at a few values.
//!
//! The cases, with the tests of each: tests of this folder by module and name, others with their folder before it.
//!
//! 1. scaled scenes: `placement::powers_of_two_change_no_bit`, `placement::other_scales_change_the_noise_only`
//! 2. far from the origin: `placement::offsets_change_nothing`
//! 3. slivers: `placement::needles_are_as_accurate_as_other_triangles`, `kernels::traverse::slivers_leave_no_gaps`
//! 4. triangles of no area: `geometry::triangles_without_area_change_nothing`,
//!    `scene::geometry::slivers_stay_and_degenerate_triangles_go`
//! 5. coplanar surfaces: `geometry::coincident_surfaces_act_as_one`,
//!    `kernels::traverse::coplanar_duplicates_go_to_the_lowest_primitive_index`
//! 6. lights that touch or pierce surfaces: `lights::lamps_may_touch_and_pierce_surfaces`,
//!    `lights::a_lamp_that_nearly_touches_has_lamberts_irradiance`
//! 7. a camera inside a solid: `geometry::a_camera_may_be_inside_a_solid`
//! 8. grazing light: `lights::grazing_light_has_lamberts_irradiance`, `kernels::terminator`
//! 9. a tiny light: `lights::a_lamp_of_any_size_has_lamberts_irradiance`
//! 10. a huge light: `lights::a_lamp_of_any_size_has_lamberts_irradiance`, `energy::furnaces_are_white` (its sky
//!     encloses the scene)
//! 11. radiance of 1e8 and 1e-8: `lights::images_are_proportional_to_radiance`,
//!     `lights::a_strong_light_does_not_change_another_room`
//! 12. the white furnace: `energy::furnaces_are_white`, `kernels::path::furnaces_are_white`
//! 13. black surfaces, single bounce: `energy::black_surfaces_leave_indirect_light_out`,
//!     `kernels::flux::bounces_are_bounded`
//! 14. one triangle: `geometry::one_triangle_is_a_scene`
//! 15. an empty scene: `geometry::scenes_may_be_dark_or_empty`,
//!     `cli::render::notes_are_said_once_and_kept_in_the_statistics`
//! 16. no light, or none that arrives: `geometry::scenes_may_be_dark_or_empty`, `cli::limits::no_light_at_all`,
//!     `cli::limits::a_camera_in_the_dark_says_so`
//! 17. numbers that are not finite: `scene::bad_input::numbers_that_are_not_finite`
//! 18. nodes scaled to nothing: `scene::geometry::zero_scales_flatten_and_what_has_no_area_is_dropped`
//! 19. negative scale: `placement::mirroring_nodes_keep_surfaces_outward`,
//!     `scene::geometry::a_mirror_flips_the_winding_once`
//! 20. shadow gaps below a pixel: `counts::thin_slats_keep_their_shadow`
//! 21. nested closed boxes: `geometry::no_light_leaves_a_closed_box`, `kernels::traverse::closed_boxes_are_watertight`
//! 22. a wall 1e-5 thick: `geometry::no_light_passes_a_thin_wall`,
//!     `images::indirect::no_light_leaks_through_thin_walls`
//! 23. many lights: `lights::many_lights_equal_the_whole_lamp`, `cli::limits::a_hundred_thousand_lights`
//! 24. photons: one, or a cell full: `counts::one_photon_or_a_full_cell_is_enough`,
//!     `kernels::grid::crowded_cells_keep_every_photon`
//! 25. identical centroids: `kernels::traverse::identical_centroids_are_traced`, `src/bvh/tests.rs`
//! 26. squares beyond f32: `placement::squared_sizes_may_be_beyond_f32`
//! 27. open meshes, mixed winding: `geometry::shadows_do_not_depend_on_winding`
//! 28. rays along axes: `kernels::traverse::rays_along_axes_meet_grids_at_their_corners`
//! 29. more layers than shadow photons of a ray:
//!     `kernels::photon_lights::a_ray_through_ten_thousand_layers_keeps_its_cap`
//! 30. a full photon buffer: `kernels::flux::what_has_no_room_is_counted`, `kernels::photons::batches_lose_nothing`
//! 31. masks and blending: `counts::panes_transmit_their_share`, `kernels::photons::holes_of_masks_let_photons_through`
//! 32. long work in parts: `kernels::primary::tiles_and_samples_are_the_whole`, `kernels::flux::batches_do_not_show`
//! 33. foreign checkpoints: `cli::render::checkpoints_of_something_else_are_refused`
//! 34. images of no, one and many pixels: `counts::images_may_have_any_shape`,
//!     `cli::usage::wrong_usage_names_the_option`, `cli::limits::one_pixel_of_one_sample`
//! 35. a view of nothing: `cli::limits::a_camera_that_sees_nothing_says_why`
//! 36. an environment alone: `cli::limits::an_environment_alone`
//!
//! Further cases:
//!
//! - rooms joined by a slit: `energy::light_passes_through_a_slit`
//! - nearly a mirror: `energy::metals_become_mirrors`
//! - records in corners: `energy::furnace_corners_are_white`
//! - gradients at grazing samples: `kernels::gather::records_are_closed_forms_of_a_ceiling`,
//!   `energy::furnace_corners_are_white`

mod chart;
mod counts;
mod determinism;
#[path = "../common/device.rs"]
mod device;
mod energy;
mod geometry;
mod lights;
mod placement;
#[allow(dead_code)]
#[path = "../common/procedurals.rs"]
mod procedurals;
mod setup;
