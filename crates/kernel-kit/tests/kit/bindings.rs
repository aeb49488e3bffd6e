//! Bindings are found by name, and what is missing or too much is named.

use kernel_kit::{
    Bindings as _, Buffer, Composed, Composer, Declared, Error, Features, Gpu, Host, Kernel, Resources, Table,
    TableFormat, bindings, kernel_test, wgpu,
};

use crate::dispatches::SQUARES;

bindings! {
    /// What the squaring kernel reads and writes.
    struct SquareBindings { numbers: &Buffer, squares: &Buffer }
}

bindings! {
    /// Fields of every kind.
    pub struct AllKinds {
        /// A buffer.
        pub numbers: &Buffer,
        pub squares: Option<&Buffer>,
        table: &Table,
        more: Option<&Table>,
        view: Option<&wgpu::TextureView>,
    }
}

fn composed(source: &str) -> Composed {
    Composer::new().compose_source("squares", source, &Features::none()).unwrap()
}

fn problem<T>(outcome: kernel_kit::Result<T>) -> String {
    let error = outcome.err().expect("must fail");
    assert!(matches!(&error, Error::Kernel { kernel, .. } if kernel.starts_with("squares")), "{error}");
    error.to_string()
}

/// A forgotten binding, a misspelt override and a binding that the kernel lacks are named, not ignored.
#[kernel_test]
fn wrong_bindings_are_named(gpu: &Gpu) {
    let composed = composed(SQUARES);
    let new = |host: &Host<'_>| Kernel::new(gpu, &composed, host);
    assert!(problem(new(&Host { constants: &[("faktor", 1.0)], ..Host::default() })).contains("'faktor'"));
    let factor = Host { constants: &[("factor", 1.0)], ..Host::default() };
    let cubes = Declared { required: &["cubes"], optional: &[] };
    assert!(problem(new(&Host { own: &[cubes], ..factor })).contains("'cubes'"));
    let kernel = new(&factor).unwrap();
    let input = gpu.upload("test/numbers", &[1u32]).unwrap();
    let problem = problem(kernel.bind(gpu, "square", &[&Resources::new().with("numbers", &input)]));
    assert!(problem.contains("squares/square") && problem.contains("'squares'"), "{problem}");
    assert!(kernel.bind(gpu, "cube", &[]).err().unwrap().to_string().contains("'cube'"));
}

/// A variable that no declared set has is named when the kernel is made, and one that a common set has is not.
#[kernel_test]
fn undeclared_variables_are_named(gpu: &Gpu) {
    let composed = composed(SQUARES);
    let factor = Host { constants: &[("factor", 1.0)], ..Host::default() };
    let (numbers, squares) =
        (Declared { required: &["numbers"], optional: &[] }, Declared { required: &[], optional: &["squares"] });
    let new =
        |own: &[Declared], common: Option<&[Declared]>| Kernel::new(gpu, &composed, &Host { own, common, ..factor });
    assert!(problem(new(&[numbers], Some(&[]))).contains("'squares'"));
    new(&[numbers], None).unwrap();
    new(&[numbers, squares], Some(&[])).unwrap();
    let others = Declared { required: &["elsewhere", "squares"], optional: &[] };
    new(&[numbers], Some(&[others])).unwrap();
    new(&[SquareBindings::DECLARED], Some(&[])).unwrap();
}

/// Sets are searched in their order, optional fields may be empty, and a set of sets is a set.
#[kernel_test]
fn fields_are_found_by_name(gpu: &Gpu) {
    let table = gpu.table("test/table", &[[1u32; 4]], TableFormat::Uint).unwrap();
    let (numbers, squares) = (gpu.upload("test/a", &[7u32; 4]).unwrap(), gpu.poisoned::<u32>("test/b", 4).unwrap());
    let some = AllKinds { numbers: &numbers, squares: None, table: &table, more: Some(&table), view: None };
    assert_eq!(AllKinds::DECLARED.required, ["numbers", "table"]);
    assert_eq!(AllKinds::DECLARED.optional, ["squares", "more", "view"]);
    let there = ["numbers", "squares", "table", "more", "view", "other"].map(|name| some.get(name).is_some());
    assert_eq!(there, [true, false, true, true, false, false]);
    let kernel =
        Kernel::new(gpu, &composed(SQUARES), &Host { constants: &[("factor", 2.0)], ..Host::default() }).unwrap();
    let both = SquareBindings { numbers: &squares, squares: &squares };
    let bound = kernel.bind(gpu, "square", &[&[&some as &dyn kernel_kit::Bindings, &both]]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, 4, &());
    frame.submit().unwrap();
    assert_eq!(gpu.read::<u32>(&squares, 4).unwrap(), [98; 4]);
}

/// A texture bound to a buffer's variable is an error that names the kernel. On a device of its own: the fault stays.
#[test]
fn resources_of_the_wrong_kind_are_named() {
    let gpu = Gpu::open(&crate::devices::same_device()).unwrap();
    let kernel =
        Kernel::new(&gpu, &composed(SQUARES), &Host { constants: &[("factor", 1.0)], ..Host::default() }).unwrap();
    let texture = gpu.table_texture("test/texture", 1, TableFormat::Uint).unwrap();
    let view = texture.create_view(&Default::default());
    let output = gpu.poisoned::<u32>("test/squares", 4).unwrap();
    let sets = Resources::new().with("numbers", &view).with("squares", &output);
    assert!(problem(kernel.bind(&gpu, "square", &[&sets])).contains("squares/square"));
}
