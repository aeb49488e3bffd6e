//! Files of WGSL functions: parsed by naga, restricted to pure functions, and rewritten so that all loops end.

use naga::back::wgsl::WriterFlags;
use naga::valid::{Capabilities, ModuleInfo, ShaderStages, ValidationFlags, Validator};
use naga::{
    AddressSpace, BinaryOperator, Block, Expression, Function, GlobalVariable, Handle, Literal, Module, Range, Scalar,
    SourceLocation, Span, Statement, Type, TypeInner, VectorSize,
};

use super::limits::ITERATIONS;
use super::role::Role;

/// Maximum size of a file in bytes, for which [`STACK_BYTES`] is enough.
const MAX_BYTES: usize = 1 << 16;

/// Maximum number of expressions in a function and its callees, each call counted. A compiler may inline every call, so
/// a chain of functions that call the next one twice grows exponentially.
const MAX_EXPRESSIONS: usize = 1 << 14;

/// Maximum nesting of statements and of expressions, which compilers process recursively.
const MAX_DEPTH: usize = 100;

/// Maximum size of a value in bytes. Software devices store it for each invocation.
const MAX_VALUE_BYTES: u32 = 4096;

/// Stack size for parsing a file of [`MAX_BYTES`]. Naga recurses for every operator of a sum, with some hundred bytes
/// per level. An operator and its operand are two bytes of the file or more, so this leaves 8 KiB for each level.
const STACK_BYTES: usize = 1 << 28;

/// Prefix of the names that the composer gives to functions and to the counter.
const RESERVED_PREFIX: &str = "procedural_";

/// The variable in which all loops count their iterations; see `functions.wgsl`.
const COUNTER: &str = "procedural_iterations";

const NUMBER: TypeInner = TypeInner::Scalar(Scalar::F32);
const VECTOR_3: TypeInner = TypeInner::Vector { size: VectorSize::Tri, scalar: Scalar::F32 };
const VECTOR_4: TypeInner = TypeInner::Vector { size: VectorSize::Quad, scalar: Scalar::F32 };

type Checked<T> = std::result::Result<T, String>;

/// A file of functions.
pub(super) struct File {
    /// The text of the file.
    pub source: String,
    module: Module,
}

impl File {
    /// Parses and checks a file.
    pub fn read(source: &str) -> Checked<File> {
        if source.len() > MAX_BYTES {
            return Err(format!("has {} bytes, at most {MAX_BYTES} are allowed", source.len()));
        }
        let read = || {
            let module = naga::front::wgsl::parse_str(source).map_err(|e| match e.location(source) {
                // Errors without a location are the nesting limit of naga, or internal.
                None => format!("cannot be parsed, perhaps because it is nested too deep: {}", e.message()),
                at => at_line(e.message(), at),
            })?;
            check_size(&module)?;
            let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
            let info = validator.validate(&module).map_err(|e| at_line(&causes(e.as_inner()), e.location(source)))?;
            check_purity(&module, &info)?;
            Ok(module)
        };
        let module = std::thread::scope(|scope| {
            let thread = std::thread::Builder::new().stack_size(STACK_BYTES).spawn_scoped(scope, read);
            thread.map_err(|e| e.to_string())?.join().unwrap_or_else(|_| Err("cannot be parsed by naga".to_owned()))
        })?;
        Ok(File { source: source.to_owned(), module })
    }

    /// Checks that there is a function `name`, and that it has the signature of its role.
    pub fn check(&self, name: &str, role: Role) -> Checked<()> {
        let mut functions = self.module.functions.iter();
        let found = functions.find(|(_, f)| f.name.as_deref() == Some(name));
        let (_, function) = found.ok_or_else(|| format!("has no function \"{name}\""))?;
        let (form, arguments, result) = match role {
            Role::Intersection => (
                "fn(origin: vec3f, direction: vec3f, nearest: f32, parameters: vec4f) -> vec4f",
                &[VECTOR_3, VECTOR_3, NUMBER, VECTOR_4][..],
                VECTOR_4,
            ),
            Role::Distance => ("fn(position: vec3f, parameters: vec4f) -> f32", &[VECTOR_3, VECTOR_4][..], NUMBER),
            Role::Colour => (
                "fn(base: vec3f, position: vec3f, parameters: vec4f) -> vec3f",
                &[VECTOR_3, VECTOR_3, VECTOR_4][..],
                VECTOR_3,
            ),
        };
        let inner = |ty: Handle<Type>| &self.module.types[ty].inner;
        let given = function.arguments.iter().map(|argument| inner(argument.ty));
        let fits = given.eq(arguments) && function.result.as_ref().is_some_and(|r| *inner(r.ty) == result);
        if fits { Ok(()) } else { Err(format!("\"{name}\" is not of the form {form}")) }
    }

    /// Writes plain WGSL whose loops end. Functions in `named` are renamed to the second name of their pair. All other
    /// names that are visible outside the file get the prefix `prefix`.
    ///
    /// # Errors
    /// One line, if naga can read the file but not write it.
    pub fn write(mut self, prefix: &str, named: &[(&str, String)]) -> Checked<String> {
        let own = |name: &Option<String>| Some(format!("{prefix}_{}", name.as_deref().unwrap_or_default()));
        let module = &mut self.module;
        for (_, function) in module.functions.iter_mut() {
            let new = named.iter().find(|(name, _)| function.name.as_deref() == Some(name));
            function.name = new.map_or_else(|| own(&function.name), |(_, new)| Some(new.clone()));
            // Naga resolves a clash of names by renaming the function, so local names with the reserved prefix are
            // renamed first.
            let arguments = function.arguments.iter_mut().filter_map(|argument| argument.name.as_mut());
            let variables = function.local_variables.iter_mut().filter_map(|(_, variable)| variable.name.as_mut());
            let values = function.named_expressions.values_mut();
            for name in arguments.chain(variables).chain(values).filter(|name| name.starts_with(RESERVED_PREFIX)) {
                name.insert_str(0, "own_");
            }
        }
        for (_, constant) in module.constants.iter_mut().filter(|(_, constant)| constant.name.is_some()) {
            constant.name = own(&constant.name);
        }
        let types: Vec<(Handle<Type>, Type)> = module.types.iter().map(|(handle, ty)| (handle, ty.clone())).collect();
        for (handle, ty) in types.into_iter().filter(|(_, ty)| matches!(ty.inner, TypeInner::Struct { .. })) {
            module.types.replace(handle, Type { name: own(&ty.name), ..ty });
        }
        bound_loops(module);
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
        let info = validator.validate(module).map_err(|e| causes(e.as_inner()))?;
        let text = naga::back::wgsl::write_string(module, &info, WriterFlags::empty()).map_err(|e| e.to_string())?;
        // All files share the counter, which `functions.wgsl` declares.
        let declares = |line: &&str| line.starts_with("var<private>") && line.contains(COUNTER);
        Ok(text.lines().filter(|line| !declares(line)).flat_map(|line| [line, "\n"]).collect())
    }
}

/// A problem of naga's on one line, after the number of its line in the file if that is known. Names of the file are in
/// double quotes: backticks are for settings.
fn at_line(problem: &str, location: Option<SourceLocation>) -> String {
    let problem = problem.split_whitespace().collect::<Vec<_>>().join(" ").replace('`', "\"");
    location.map_or(problem.clone(), |at| format!("line {}: {problem}", at.line_number))
}

/// An error with its chain of causes.
fn causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// Refuses files that would take too much time or memory to process or to compile.
fn check_size(module: &Module) -> Checked<()> {
    let large =
        |(_, ty): &(Handle<Type>, &Type)| ty.inner.try_size(module.to_ctx()).is_none_or(|n| n > MAX_VALUE_BYTES);
    if let Some((_, ty)) = module.types.iter().find(large) {
        let name = ty.name.as_deref().unwrap_or("an array");
        return Err(format!("{name} takes more than {MAX_VALUE_BYTES} bytes"));
    }
    let mut cost: Vec<usize> = Vec::new();
    for (_, function) in module.functions.iter() {
        let name = function.name.as_deref().unwrap_or_default();
        let statements = Statements::of(function);
        // Operands precede the expressions that use them.
        let mut depths: Vec<usize> = Vec::with_capacity(function.expressions.len());
        for (_, expression) in function.expressions.iter() {
            let depth = operands(expression).into_iter().map(|operand| depths[operand.index()] + 1).max();
            depths.push(depth.unwrap_or(0));
        }
        if statements.depth.max(depths.into_iter().max().unwrap_or(0)) > MAX_DEPTH {
            return Err(format!("\"{name}\" is nested more than {MAX_DEPTH} deep"));
        }
        // Functions precede their callers.
        let called: usize = statements.calls.iter().map(|callee| cost.get(callee.index()).copied().unwrap_or(0)).sum();
        // A variable counts as many expressions as it has words.
        let words =
            function.local_variables.iter().map(|(_, v)| module.types[v.ty].inner.size(module.to_ctx()) as usize / 4);
        let total = (function.expressions.len() + words.sum::<usize>()).saturating_add(called);
        if total > MAX_EXPRESSIONS {
            return Err(format!(
                "\"{name}\" and the functions that it calls have {total} expressions, the maximum is {MAX_EXPRESSIONS}"
            ));
        }
        cost.push(total);
    }
    Ok(())
}

/// Refuses everything but pure functions, structs and constants.
fn check_purity(module: &Module, info: &ModuleInfo) -> Checked<()> {
    let refuse = |what: String| Err(format!("{what}: such a file may contain only functions, structs and constants"));
    if let Some((_, variable)) = module.global_variables.iter().next() {
        return refuse(format!("declares the variable \"{}\"", variable.name.as_deref().unwrap_or_default()));
    }
    if let Some((_, value)) = module.overrides.iter().next() {
        return refuse(format!("declares the override \"{}\"", value.name.as_deref().unwrap_or_default()));
    }
    if let Some(entry) = module.entry_points.first() {
        return refuse(format!("declares the entry point \"{}\"", entry.name));
    }
    for (handle, function) in module.functions.iter() {
        let name = function.name.as_deref().unwrap_or_default();
        let statements = Statements::of(function);
        if statements.impure || !info[handle].available_stages.contains(ShaderStages::COMPUTE) {
            return Err(format!(
                "\"{name}\" does more than compute: it discards, waits for other invocations or reads their values"
            ));
        }
    }
    Ok(())
}

/// Facts about the statements of a function.
#[derive(Default)]
struct Statements {
    depth: usize,
    calls: Vec<Handle<Function>>,
    /// Whether there is a statement other than control flow, calls, and stores to local variables.
    impure: bool,
}

impl Statements {
    fn of(function: &Function) -> Self {
        let mut statements = Statements::default();
        statements.block(&function.body, 0);
        statements
    }

    fn block(&mut self, block: &Block, depth: usize) {
        self.depth = self.depth.max(depth);
        for statement in block {
            match statement {
                Statement::Block(inner) => self.block(inner, depth + 1),
                Statement::If { accept, reject, .. } => {
                    self.block(accept, depth + 1);
                    self.block(reject, depth + 1);
                }
                Statement::Switch { cases, .. } => cases.iter().for_each(|case| self.block(&case.body, depth + 1)),
                Statement::Loop { body, continuing, .. } => {
                    self.block(body, depth + 1);
                    self.block(continuing, depth + 1);
                }
                Statement::Call { function, .. } => self.calls.push(*function),
                Statement::Emit(_)
                | Statement::Break
                | Statement::Continue
                | Statement::Return { .. }
                | Statement::Store { .. } => {}
                _ => self.impure = true,
            }
        }
    }
}

/// The operands of an expression in a module without global variables.
fn operands(expression: &Expression) -> Vec<Handle<Expression>> {
    use Expression::*;
    match expression {
        Compose { components, .. } => components.clone(),
        Access { base, index } => vec![*base, *index],
        AccessIndex { base, .. } => vec![*base],
        Splat { value, .. } => vec![*value],
        Swizzle { vector, .. } => vec![*vector],
        Load { pointer } => vec![*pointer],
        Unary { expr, .. } | As { expr, .. } => vec![*expr],
        Binary { left, right, .. } => vec![*left, *right],
        Select { condition, accept, reject } => vec![*condition, *accept, *reject],
        Relational { argument, .. } => vec![*argument],
        Math { arg, arg1, arg2, arg3, .. } => [Some(*arg), *arg1, *arg2, *arg3].into_iter().flatten().collect(),
        _ => Vec::new(),
    }
}

/// Makes every loop count its iterations, and break once there were [`ITERATIONS`] in all loops together.
fn bound_loops(module: &mut Module) {
    let count = Type { name: None, inner: TypeInner::Scalar(Scalar::U32) };
    let ty = module.types.insert(count, Span::UNDEFINED);
    let counter = GlobalVariable {
        name: Some(COUNTER.to_owned()),
        space: AddressSpace::Private,
        binding: None,
        ty,
        init: None,
        memory_decorations: Default::default(),
    };
    let counter = module.global_variables.append(counter, Span::UNDEFINED);
    for (_, function) in module.functions.iter_mut() {
        let mut body = std::mem::take(&mut function.body);
        bound_block(&mut body, function, counter);
        function.body = body;
    }
}

fn bound_block(block: &mut Block, function: &mut Function, counter: Handle<GlobalVariable>) {
    for statement in block.iter_mut() {
        match statement {
            Statement::Block(inner) => bound_block(inner, function, counter),
            Statement::If { accept, reject, .. } => {
                bound_block(accept, function, counter);
                bound_block(reject, function, counter);
            }
            Statement::Switch { cases, .. } => {
                cases.iter_mut().for_each(|case| bound_block(&mut case.body, function, counter));
            }
            Statement::Loop { body, continuing, .. } => {
                bound_block(body, function, counter);
                bound_block(continuing, function, counter);
                let mut bounded = Block::from_vec(count_iteration(function, counter));
                bounded.append(body);
                *body = bounded;
            }
            _ => {}
        }
    }
}

/// `let before = counter; counter = before + 1; if before >= ITERATIONS { break; }`
fn count_iteration(function: &mut Function, counter: Handle<GlobalVariable>) -> Vec<Statement> {
    let mut add = |expression| function.expressions.append(expression, Span::UNDEFINED);
    let pointer = add(Expression::GlobalVariable(counter));
    let limit = add(Expression::Literal(Literal::U32(ITERATIONS)));
    let one = add(Expression::Literal(Literal::U32(1)));
    let before = add(Expression::Load { pointer });
    let spent = add(Expression::Binary { op: BinaryOperator::GreaterEqual, left: before, right: limit });
    let value = add(Expression::Binary { op: BinaryOperator::Add, left: before, right: one });
    vec![
        Statement::Emit(Range::new_from_bounds(before, value)),
        Statement::Store { pointer, value },
        Statement::If { condition: spent, accept: Block::from_vec(vec![Statement::Break]), reject: Block::new() },
    ]
}
