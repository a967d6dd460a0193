import java.io.BufferedReader;
import java.io.File;
import java.io.InputStreamReader;
import java.util.Arrays;
import java.util.stream.Collectors;
import no.ntnu.ihb.fmi4j.FmiStatus;
import no.ntnu.ihb.fmi4j.importer.fmi2.AbstractModelInstance;
import no.ntnu.ihb.fmi4j.importer.fmi2.CoSimulationSlave;
import no.ntnu.ihb.fmi4j.importer.fmi2.Fmu;
import no.ntnu.ihb.fmi4j.importer.fmi2.ModelExchangeInstance;

/**
 * Runs FMI 2.0 FMUs in FMI4j. Each line that comes in is a job: path, step [s], count of steps, inner steps for model
 * exchange (0: co-simulation) and value references, separated by tabs. Out come a row of values for the start and
 * after each step, and an empty line after each job.
 */
final class Fmi4j {
    private final double step;
    private final int count;
    private final int inner;
    private final long[] references;

    private Fmi4j(String[] job) {
        step = Double.parseDouble(job[1]);
        count = Integer.parseInt(job[2]);
        inner = Integer.parseInt(job[3]);
        references = Arrays.stream(job[4].split(",")).mapToLong(Long::parseLong).toArray();
    }

    public static void main(String[] arguments) throws Exception {
        BufferedReader jobs = new BufferedReader(new InputStreamReader(System.in));
        for (String line = jobs.readLine(); line != null; line = jobs.readLine()) {
            String[] job = line.split("\t");
            try (Fmu fmu = Fmu.from(new File(job[0]))) {
                new Fmi4j(job).run(fmu);
            }
            System.out.println();
        }
    }

    private void run(Fmu fmu) {
        if (inner == 0) {
            try (CoSimulationSlave slave = fmu.asCoSimulationFmu().newInstance("tested")) {
                step(slave);
            }
        } else {
            try (ModelExchangeInstance instance = fmu.asModelExchangeFmu().newInstance("tested")) {
                integrate(instance, fmu.getModelDescription().getModelStructure().getDerivatives().size());
            }
        }
    }

    private void begin(AbstractModelInstance<?, ?> instance) {
        require(instance.setupExperiment(0, 0, 0), "setupExperiment");
        require(instance.enterInitializationMode(), "enterInitializationMode");
        require(instance.exitInitializationMode(), "exitInitializationMode");
    }

    private void step(CoSimulationSlave slave) {
        begin(slave);
        print(slave);
        for (int k = 0; k < count; k++) {
            require(slave.doStep(k * step, step), "doStep");
            print(slave);
        }
        require(slave.terminate(), "terminate");
    }

    /** By the classical Runge-Kutta method. */
    private void integrate(ModelExchangeInstance instance, int states) {
        begin(instance);
        require(instance.newDiscreteStates(), "newDiscreteStates");
        require(instance.enterContinuousTimeMode(), "enterContinuousTimeMode");
        double[] x = new double[states];
        require(instance.getContinuousStates(x), "getContinuousStates");
        print(instance);
        for (int k = 0; k < count; k++) {
            for (int i = 0; i < inner; i++)
                x = advanced(instance, k * step + i * step / inner, x, step / inner);
            move(instance, (k + 1) * step, x);
            instance.completedIntegratorStep();
            print(instance);
        }
        require(instance.terminate(), "terminate");
    }

    private static double[] advanced(ModelExchangeInstance instance, double t, double[] x, double h) {
        double[] k1 = rate(instance, t, x);
        double[] k2 = rate(instance, t + h / 2, sum(x, h / 2, k1));
        double[] k3 = rate(instance, t + h / 2, sum(x, h / 2, k2));
        double[] k4 = rate(instance, t + h, sum(x, h, k3));
        double[] next = x.clone();
        for (int i = 0; i < x.length; i++)
            next[i] += h / 6 * (k1[i] + 2 * (k2[i] + k3[i]) + k4[i]);
        return next;
    }

    private static double[] rate(ModelExchangeInstance instance, double t, double[] x) {
        double[] derivatives = new double[x.length];
        move(instance, t, x);
        require(instance.getDerivatives(derivatives), "getDerivatives");
        return derivatives;
    }

    private static void move(ModelExchangeInstance instance, double t, double[] x) {
        require(instance.setTime(t), "setTime");
        require(instance.setContinuousStates(x), "setContinuousStates");
    }

    private static double[] sum(double[] x, double factor, double[] y) {
        double[] result = x.clone();
        for (int i = 0; i < x.length; i++)
            result[i] += factor * y[i];
        return result;
    }

    private void print(AbstractModelInstance<?, ?> instance) {
        double[] values = new double[references.length];
        require(instance.readReal(references, values), "readReal");
        System.out.println(Arrays.stream(values).mapToObj(Double::toString).collect(Collectors.joining(" ")));
    }

    private static void require(FmiStatus status, String call) {
        require(status.isOK(), call + ": " + status);
    }

    private static void require(boolean fine, String call) {
        if (!fine)
            throw new IllegalStateException(call + " failed");
    }
}
