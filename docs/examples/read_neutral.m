function c = read_neutral(file, state)
% Coefficients of an aircraft that sideslip export --to neutral wrote: c = read_neutral('aircraft.json', struct('V', 20, 'alpha', 0.05))
m = jsondecode(fileread(file)); known = struct();
for i = 1:numel(m.variables), known.(m.variables(i).name) = 0; end
for n = fieldnames(m.constants)', known.(n{1}) = m.constants.(n{1}).value; end
for n = fieldnames(state)', known.(n{1}) = state.(n{1}); end
for i = 1:numel(m.lines), known.(m.lines(i).name) = value(m.lines(i).tree, known); end
for i = 1:numel(m.outputs), c.(m.outputs{i}) = known.(m.outputs{i}); end
end

function v = value(tree, known)
if isnumeric(tree), v = tree; return, elseif ischar(tree), v = known.(tree); return, end
a = cellfun(@(t) value(t, known), tree(2:end), 'UniformOutput', false);
names = {'+', '-', '*', '/', '**', '<', '<=', '>', '>=', 'neg', 'where', 'sin', 'cos', 'tan', 'asin', 'acos', 'atan', 'atan2', ...
         'sinh', 'cosh', 'tanh', 'sqrt', 'exp', 'log', 'abs', 'sign', 'min', 'max'};
does = {@plus, @minus, @times, @rdivide, @power, @lt, @le, @gt, @ge, @uminus, @pick, @sin, @cos, @tan, @asin, @acos, @atan, @atan2, ...
        @sinh, @cosh, @tanh, @sqrt, @exp, @log, @abs, @sign, @min, @max};
v = does{strcmp(tree{1}, names)}(a{:});
end

function v = pick(condition, x, y)
if condition, v = x; else, v = y; end
end
